"""When the camera of a photograph becomes the scene's camera, the scene gets the image size and the pixel
aspect of the photograph.

This happens once per change of the camera. A user who sets another size afterwards keeps it.
"""

from __future__ import annotations

import bpy

from ..data import camera_object, known


def follow(scene, *_):
    """Called after every change of the scene."""
    before = known.of_scene(scene).camera
    remember(scene)
    if before not in (None, known.of_scene(scene).camera):
        camera_object.apply_camera_size(scene)


def remember(scene: bpy.types.Scene):
    known.of_scene(scene).camera = scene.camera.session_uid if scene.camera is not None else 0


def _after_load(*_):
    """The render size of an opened file stays as it was saved."""
    for scene in bpy.data.scenes:
        remember(scene)


HANDLERS = {"depsgraph_update_post": follow, "render_init": follow, "load_post": _after_load}
