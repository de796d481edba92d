"""Reads the add-on's preferences; panels/preferences.py defines and shows them."""

from __future__ import annotations

from ...svrgs_addon.native import library

PACKAGE = __package__.removesuffix(".operators.data")


def threads(context) -> int:
    """Number of threads to use; 0: one per core."""
    addon = context.preferences.addons.get(PACKAGE)
    return addon.preferences.threads if addon is not None and addon.preferences is not None else 0


def use_threads(context):
    """Lets the native library use that number of threads."""
    library.set_threads(threads(context))
