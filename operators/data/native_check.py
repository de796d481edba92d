"""Whether the native library works in this Blender. Without it nothing can be drawn or pruned."""

from __future__ import annotations

from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.native import library
from ...svrgs_addon.system.errors import NativeError


def native_problem() -> str:
    """What to do if the native library does not load; empty if it does."""
    try:
        library.best_level()
    except NativeError:  # it is missing, or built for another computer, or of another version
        return tr("The native library does not load: install the extension's zip again")
    return ""
