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
    now = known.of_scene(scene)
    camera, size = now.camera, now.size
    remember(scene)
    if camera in (None, now.camera):
        return
    if size != now.size and now.size != camera_object.photograph_size(scene):
        now.chosen_size = now.size
    bound = any(marker.camera == scene.camera for marker in scene.timeline_markers)
    if now.size != now.chosen_size and not bound:
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
