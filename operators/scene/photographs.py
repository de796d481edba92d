"""The cameras of a dataset as a list of photographs, with what the last job found about each."""

from __future__ import annotations

import os
from collections.abc import Callable
from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.jobs.photo_mask import read_in_child
from ...svrgs_addon.views.valid_pixels import BACKGROUND, MaskOptions
from ..data import background_work, camera_object, image_pixels, known, splat_object
from . import dataset_paths

FOUND = "svrgs_photograph"  # property of a photograph's camera: figures of the last job, by name
TINT = (0.8, 0.1, 0.1, 0.6)  # of what does not count


def of(root: bpy.types.Object | None) -> list[bpy.types.Object]:
    """The cameras of photographs below a root, in the order of their images' names."""
    below = root.children_recursive if root is not None else ()
    return sorted(camera_object.photographs(below), key=lambda obj: obj.data[camera_object.IMAGE])


def store(root: bpy.types.Object | None, found: dict[str, dict[str, float]], masks: str = ""):
    """What a job found about each photograph, by the name of its image, and the folder of the masks that it
    wrote. Those that it has nothing about lose what an earlier job found."""
    if root is not None:
        root[splat_object.MASKS] = masks
    for obj in of(root):
        obj.data.pop(FOUND, None)
        if figures := found.get(obj.data[camera_object.IMAGE]):
            obj.data[FOUND] = figures


def about(obj: bpy.types.Object) -> str:
    """What the last job found about a photograph: its exposure, by how many pixels its camera was moved, and
    what share of it is hidden; '' for nothing."""
    found = obj.data.get(FOUND, {})
    texts = {"exposure_ev": "{:+.2f} EV", "moved_pixels": "{:.1f} px", "hidden": tr("{:.0%} hidden")}
    return ", ".join(text.format(found[name]) for name, text in texts.items() if name in found)


def look_through(settings, context):
    """Makes the chosen photograph's camera the scene's camera, and looks through it in the 3D view in which
    it was chosen."""
    row, shown = settings.photograph, of(splat_object.root_of(context.object))
    if not 0 <= row < len(bpy.data.objects) or bpy.data.objects[row] not in shown:
        return
    context.scene.camera = bpy.data.objects[row]
    show_mask(settings, context)
    if getattr(context.space_data, "region_3d", None) is not None:
        context.space_data.region_3d.view_perspective = "CAMERA"


def show_mask(settings, context):
    """Lays what does not count over the picture of the scene's camera, and over no other; over none if that
    is switched off, or if the photograph has no mask. The masks are read in a thread."""
    root, camera = splat_object.root_of(context.object), context.scene.camera
    for data in (one for one in bpy.data.cameras if one.library is None):  # also those of other datasets
        shown = [one for one in data.background_images if one.image is not None]
        for background in (one for one in shown if one.image.name == camera_object.MASKED_OUT):
            data.background_images.remove(background)
    if root is None:
        return
    known.of(root).mask_problem = ""
    if not settings.show_masks or camera not in of(root) or camera.data.library is not None:
        return
    uid, uid_of_root = camera.session_uid, root.session_uid

    def done(valid, problem: str):
        """Meanwhile another photograph may be looked at, or another file be open."""
        views = {scene.camera.session_uid: scene for scene in bpy.data.scenes if scene.camera is not None}
        if uid not in views or not views[uid].svrgs_view.show_masks:
            return
        known.of_uid(uid_of_root).mask_problem = problem
        lay_over(views[uid].camera, valid)

    background_work.run(mask_reader(context, camera), done, detached=True)


def lay_over(camera: bpy.types.Object, valid):
    """Tints what does not count in the picture behind a camera. valid: (H, W), 0 there; None: all counts."""
    shown = [one.image for one in camera.data.background_images if one.image is not None]
    if valid is None or any(image.name == camera_object.MASKED_OUT for image in shown):
        return
    background = camera.data.background_images.new()
    background.image = image_pixels.write_tint(camera_object.MASKED_OUT, valid == 0, TINT)
    background.frame_method, background.display_depth, background.alpha = "STRETCH", "FRONT", 1.0
    camera.data.show_background_images = True


def mask_reader(context, camera: bpy.types.Object) -> Callable:
    """Reads what counts in a photograph, as photo_mask.read_in_child(), without bpy: by the masks of the last
    job, by the folder that was chosen, or as the dataset says. Those of a job are never inverted; they
    mark distractors, so they are left out where what a mask hides is painted."""
    root, settings = splat_object.root_of(camera), context.scene.svrgs_prune
    folder = dataset_paths.dataset_of_root(root) if root is not None else ""
    if root is None or camera_object.IMAGE not in camera.data or not os.path.exists(folder):
        return lambda: None
    own, chosen = dataset_paths.masks_of_job(root), dataset_paths.absolute(settings.masks)
    masks = [MaskOptions(Path(chosen) if chosen else None, settings.invert_masks, settings.outside)]
    if os.path.isdir(own) and settings.outside != BACKGROUND:
        masks.insert(0, MaskOptions(Path(own)))
    images = root.get(splat_object.IMAGES, "")
    return partial(read_in_child, folder, images, camera.data[camera_object.IMAGE], masks)
