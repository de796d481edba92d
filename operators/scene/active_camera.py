"""When the camera of a photograph becomes the scene's camera, the scene gets the image size and the pixel
aspect of the photograph.

This happens once per change of the camera. A user who sets another size afterwards keeps it, and so does one
who sets it together with the camera, undoes a change of the camera, or whose markers change it.
"""

from __future__ import annotations

import bpy

from ..data import camera_object, known


def follow(scene, *_):
    """Called after every change of the scene."""
    camera, size = known.of_scene(scene).camera, known.of_scene(scene).size
    remember(scene)
    if camera in (None, known.of_scene(scene).camera) or size != known.of_scene(scene).size:
        return
    if not any(marker.camera for marker in scene.timeline_markers):
        camera_object.apply_camera_size(scene)
        remember(scene)


def remember(scene: bpy.types.Scene):
    known.of_scene(scene).camera = scene.camera.session_uid if scene.camera is not None else 0
    known.of_scene(scene).size = scene.render.resolution_x, scene.render.resolution_y


def _after_load(*_):
    """The render size of an opened file stays as it was saved."""
    for scene in bpy.data.scenes:
        remember(scene)


HANDLERS = {"depsgraph_update_post": follow, "render_init": follow, "load_post": _after_load}
