"""The extension itself: its name in Blender, its preferences (panels/preferences.py defines and shows them),
and whether its native library works. Without that nothing can be drawn or pruned."""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.native import library
from ...svrgs_addon.system.errors import NativeError

PACKAGE = __package__.removesuffix(".operators.data")


def native_problem() -> str:
    """What to do if the native library does not load; empty if it does."""
    try:
        library.best_level()
    except NativeError:  # it is missing, or built for another computer, or of another version
        return tr("The native library does not load: install the extension's zip again")
    return ""


def threads(context) -> int:
    """Number of threads to use; 0: one per core."""
    addon = context.preferences.addons.get(PACKAGE)
    return addon.preferences.threads if addon is not None and addon.preferences is not None else 0


def use_threads(context):
    """Lets the native library use that number of threads."""
    library.set_threads(threads(context))
