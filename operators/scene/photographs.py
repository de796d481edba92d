"""The cameras of a dataset as a list of photographs, with what the last job found about each."""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.views.valid_pixels import FOLDER, LOSSY, MaskOptions, Masks
from ..data import camera_object, image_pixels, splat_object
from . import dataset_paths

FOUND = "svrgs_photograph"  # property of a photograph's camera: figures of the last job, by name
MASKS = "svrgs_masks"  # property of the root of cameras: the folder of the masks of the last job
TINT = (0.8, 0.1, 0.1, 0.6)  # of what does not count


def of(root: bpy.types.Object | None) -> list[bpy.types.Object]:
    """The cameras of photographs below a root, in the order of their images' names."""
    below = root.children_recursive if root is not None else ()
    cameras = [obj for obj in below if obj.type == "CAMERA" and camera_object.IMAGE in obj.data]
    return sorted(cameras, key=lambda obj: obj.data[camera_object.IMAGE])


def store(root: bpy.types.Object | None, found: dict[str, dict[str, float]], masks: str = ""):
    """What a job found about each photograph, by the name of its image, and the folder of the masks that it
    wrote. Those that it has nothing about lose what an earlier job found."""
    if root is not None:
        root[MASKS] = masks
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
    is switched off, or if the photograph has no mask."""
    root = splat_object.root_of(context.object)
    for obj in (one for one in of(root) if one.data.library is None):
        backgrounds = obj.data.background_images
        for background in [
            one for one in backgrounds if one.image is not None and one.image.name == camera_object.MASKED_OUT
        ]:
            backgrounds.remove(background)
    camera = context.scene.camera
    shown = root is not None and settings.show_masks and camera in of(root) and camera.data.library is None
    file, inverted = mask_file(camera, root, context) if shown else (None, False)
    if file is None:
        return
    mask = bpy.data.images.load(str(file))
    pixels = image_pixels.read_image(mask)
    bpy.data.images.remove(mask)
    if pixels is None:
        return
    least = 0.5 if file.suffix.lower() in LOSSY else 0.0
    hidden = (pixels[..., 0] > least) == inverted
    background = camera.data.background_images.new()
    background.image = image_pixels.write_tint(camera_object.MASKED_OUT, hidden, TINT)
    background.frame_method, background.display_depth, background.alpha = "STRETCH", "FRONT", 1.0
    camera.data.show_background_images = True


def mask_file(camera: bpy.types.Object, root: bpy.types.Object, context) -> tuple[Path | None, bool]:
    """The mask of a photograph, of the last job, of the folder that was chosen, or beside the photographs;
    and whether its black pixels count, as may be chosen for all but those of a job."""
    settings, name = context.scene.svrgs_prune, camera.data[camera_object.IMAGE]
    own, chosen = root.get(MASKS, ""), dataset_paths.absolute(settings.masks)
    folders = [(own, False), (chosen, settings.invert_masks)]
    folders.append((str(Path(dataset_paths.dataset_of_root(root), FOLDER)), settings.invert_masks))
    for folder, inverted in folders:
        if isinstance(folder, str) and folder:
            if file := Masks(MaskOptions(), Path(folder), {}).file(name):
                return file, inverted
    return None, False
