"""When the camera of a photograph becomes the scene's camera, the scene gets the image size and the pixel
aspect of the photograph.

This happens once per change of the camera. A user who sets another size afterwards keeps it.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..data import camera_object

_seen: dict[int, int] = {}  # session_uid of a scene -> session_uid of its last camera; 0: none


@persistent
def follow(scene, *_):
    """Called after every change of the scene."""
    camera = scene.camera
    now = camera.session_uid if camera is not None else 0
    before = _seen.get(scene.session_uid)
    _seen[scene.session_uid] = now
    if before is not None and before != now:
        camera_object.apply_camera_size(scene)


@persistent
def remember(*_):
    """After a file was opened: its render size stays as it was saved."""
    _seen.clear()
    for scene in bpy.data.scenes:
        _seen[scene.session_uid] = scene.camera.session_uid if scene.camera is not None else 0


HANDLERS = {"depsgraph_update_post": follow, "render_init": follow, "load_post": remember}


def unregister():
    _seen.clear()
