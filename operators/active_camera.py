"""A photograph's camera brings the size and pixel aspect of its picture along when it becomes the scene's camera.

Only then: who wants a smaller render of the same view afterwards gets it.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from . import bridge

_seen: dict[int, int] = {}  # session_uid of a scene: of the camera it had last


@persistent
def follow(scene, *_):
    camera = scene.camera
    now = camera.session_uid if camera is not None else 0
    before = _seen.get(scene.session_uid)
    _seen[scene.session_uid] = now
    if before is not None and before != now:
        bridge.apply_camera_size(scene)


@persistent
def remember(*_):
    """Cameras that a file was saved with have had their turn."""
    _seen.clear()
    for scene in bpy.data.scenes:
        _seen[scene.session_uid] = scene.camera.session_uid if scene.camera is not None else 0


HANDLERS = (("depsgraph_update_post", follow), ("render_init", follow), ("load_post", remember))


def register():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
    _seen.clear()
