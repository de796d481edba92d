"""Why nothing can be drawn or pruned in this Blender at all."""

from __future__ import annotations

from ..svrgs_addon import native
from ..svrgs_addon.errors import NativeError


def native_problem() -> str:
    """What to do where the native library does not work; empty where it does."""
    try:
        native.best_level()
    except NativeError:  # not there, not for this computer, of another version
        return "The native library does not load: install the extension's zip again"
    return ""
