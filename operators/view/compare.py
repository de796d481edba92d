"""Compares original and pruned splat: images from a camera, and figures against its photograph."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import partial

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.images import to_bytes
from ...svrgs_addon.files.ply import file_size
from ...svrgs_addon.jobs.lpips_child import lpips_in_child
from ...svrgs_addon.native.rasterizer import Rasterizer
from ...svrgs_addon.prune.report.pictures import contact_sheet, difference_image, wipe
from ...svrgs_addon.render.metrics import psnr
from ...svrgs_addon.render.metrics.evaluate import mean_figures, picture_options, rounded_to_8_bits
from ...svrgs_addon.render.metrics.lpips import weights_file
from ...svrgs_addon.scene.camera import Camera, resized_valid
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.views.valid_pixels import BACKGROUND
from ..data import background_work, camera_object, grading, image_pixels, splat_object, visible_splats
from ..data.extension import use_threads
from ..data.pairs import in_file
from ..data.reporting import ReportingOperator
from ..data.world_matrix import world_matrix
from ..jobs import job_result
from ..scene import photographs
from ..scene.contribution import chosen_cameras
from .spatial_mask import show_in_editors

ORIGINAL, PRUNED, DIFFERENCE, WIPE = (
    f"SVR-GS {name}" for name in ("Original", "Pruned", "Difference", "Wipe")
)
SHEET = "SVR-GS Contact Sheet"
THUMBNAIL = 320  # pixels on the longer side


class ComparedSplats:
    """The original and the pruned splat of a comparison. Raises SceneError if one is missing."""

    def __init__(self, context: bpy.types.Context):
        original, pruned = chosen_pair(context)
        self.graded = any(map(grading.is_graded, (original, pruned)))
        self.scenes = job_result.before_pruning(original), shown_scene(pruned)
        places = (world_matrix(obj).copy() for obj in (original, pruned))
        self.placed = [visible_splats.placed([part]) for part in zip(self.scenes, places, strict=True)]
        self.rasterizer = Rasterizer()
        use_threads(context)

    def render(self, camera: Camera, background) -> tuple:
        """(original, pruned): images (H, W, 3) in display sRGB, rounded to 8 bits; camera: in Blender's
        world."""
        images, original = [], self.placed[0]
        # of both, in Blender's world: the pruned splat alone may have a smaller one
        unit = original.seen_by(camera).unit * original.unit
        for part in self.placed:
            options = picture_options(part.scene, background)
            view = replace(part.seen_by(camera), unit=unit / part.unit)
            found = self.rasterizer.forward(part.scene, view, options)
            images.append(rounded_to_8_bits(found["rgb"]))
        return tuple(images)


def chosen_pair(context: bpy.types.Context) -> tuple[bpy.types.Object, bpy.types.Object]:
    """(original, pruned): those chosen in the panel, or those that belong to the active object. Raises
    SceneError if one is missing."""
    settings = context.scene.svrgs_view
    original = in_file(settings.original) or job_result.pair_of(context.object)[0] or context.object
    if not splat_object.is_splat(original):
        raise SceneError(
            tr("there is nothing to compare: choose the original splat, or make it the active object")
        )
    return original, in_file(settings.pruned) or pruned_of(original)


def camera_of(context: bpy.types.Context) -> bpy.types.Object | None:
    """The camera of a comparison."""
    return in_file(context.scene.svrgs_view.compare_camera) or context.scene.camera


def guessed(context: bpy.types.Context) -> dict[str, str]:
    """The names of what is compared where the panel leaves it open; {} if there is no pair."""
    try:
        original, pruned = chosen_pair(context)
    except SceneError:
        return {}
    camera = context.scene.camera
    names = {"original": original.name, "pruned": pruned.name}
    return names | ({"compare_camera": camera.name} if camera is not None else {})


def shown_scene(pruned: bpy.types.Object) -> Scene:
    """Of a ranked result: what Apply would keep, without what the user has hidden. Of any other splat: what
    is visible of it."""
    if job_result.undecided(pruned) and job_result.ranked(pruned):
        return grading.applied(job_result.Shown(pruned).seen_gaussians, pruned)
    return visible_splats.visible_scene(pruned)


def pruned_of(original: bpy.types.Object) -> bpy.types.Object:
    """The pruned splat: a job's result, or the object 'NAME pruned', or the splat itself if some Gaussians
    are marked. Raises SceneError."""
    result = job_result.pruned_of(original)
    if result is not None:
        return result
    named = bpy.data.objects.get(f"{original.name} pruned")
    if splat_object.is_splat(named):
        return named
    if splat_object.values(original, visible_splats.REMOVED) is not None:
        return original
    text = tr("there is nothing to compare '{name}' with: prune it, or choose the pruned splat")
    raise SceneError(text.format(name=original.name))


class ComparingOperator(ReportingOperator):
    """Draws from cameras, so there must be one."""

    @classmethod
    def problem(cls, context) -> str:
        if camera_of(context) is not None:
            return ""
        return tr("There is no camera: add one, or import the cameras of the dataset")


class SVRGS_OT_compare(ComparingOperator):
    bl_label = "Compare"
    bl_description = (
        "Render original and pruned splat from the camera, side by side. Measure both against its photograph,"
        " if it has one"
    )
    bl_options = {"REGISTER"}

    def work(self, context) -> str:
        settings, splats = context.scene.svrgs_view, ComparedSplats(context)
        obj = camera_of(context)
        assert obj is not None  # see problem()
        camera = camera_object.camera_from_object(obj, context.scene)
        photo = photograph(obj)
        valid = None
        if photo is not None:
            camera = camera.resized(photo.shape[1], photo.shape[0])
            valid = counting(context, obj, photo)
        pictures = original, pruned = splats.render(camera, tuple(settings.background))
        rows = [measure(*both, photo, valid) for both in zip(splats.scenes, pictures, strict=True)]
        between = psnr(original, pruned)
        figures = {"camera": obj.name, "original": rows[0], "pruned": rows[1], "between": between}
        if valid is not None:
            figures["hidden"] = 1 - float(valid.mean())
        image_pixels.write_image(ORIGINAL, original)
        image_pixels.write_image(PRUNED, pruned)
        image_pixels.write_image(DIFFERENCE, difference_image(original, pruned))
        image = image_pixels.write_image(WIPE, wipe(original, pruned, settings.wipe), figures=figures)
        show_in_editors(image)
        if photo is not None and weights_file().is_file():
            perceived(pictures, photo, valid, figures)
        text = summary(rows, between, figures.get("hidden", 0.0))
        return f"{text}; {tr('with the settings of Color')}" if splats.graded else text


class SVRGS_OT_contact_sheet(ComparingOperator):
    bl_label = "Render All Cameras"
    bl_description = (
        "Draw original, pruned splat and their difference from every camera, as small pictures in one image"
    )
    bl_options = {"REGISTER"}

    def work(self, context) -> str:
        manager, cameras = context.window_manager, chosen_cameras(context)
        if not cameras:
            raise SceneError(tr("There is no camera: add one, or import the cameras of the dataset"))
        manager.progress_begin(0, len(cameras))
        try:
            splats, rows, worst = ComparedSplats(context), [], math.inf
            for number, obj in enumerate(cameras):
                camera = camera_object.camera_from_object(obj, context.scene)
                camera = camera.reduced(max(1, max(camera.width, camera.height) // THUMBNAIL))
                a, b = splats.render(camera, tuple(context.scene.svrgs_view.background))
                rows.append([to_bytes(a), to_bytes(b), difference_image(a, b)])
                worst = min(worst, psnr(a, b))
                manager.progress_update(number + 1)
        finally:
            manager.progress_end()
        columns = max(1, round((len(rows) / 3) ** 0.5))
        show_in_editors(image_pixels.write_image(SHEET, contact_sheet(rows, columns)))
        text = tr(
            "{count:,} cameras in '{image}': original, pruned, difference; lowest PSNR between them:"
            " {worst:.1f} dB"
        )
        return text.format(count=len(rows), image=SHEET, worst=worst)


def figures() -> dict:
    """Of the pictures of the last comparison: camera, original, pruned, between; {} without them."""
    return image_pixels.figures_of(WIPE)


def redraw(settings, context):
    """Draws the wipe again from the two images."""
    images = [bpy.data.images.get(name) for name in (ORIGINAL, PRUNED)]
    original, pruned = (None if image is None else image_pixels.read_image(image) for image in images)
    if original is not None and pruned is not None and original.shape == pruned.shape:
        image_pixels.write_image(WIPE, wipe(original, pruned, settings.wipe))


def photograph(obj: bpy.types.Object):
    """(H, W, 3) display sRGB: the camera's background image; None if it has none."""
    images = camera_object.backgrounds(obj)
    return image_pixels.read_image(images[0]) if images else None


def counting(context, obj: bpy.types.Object, photo):
    """The pixels that count where a camera's photograph is compared, (H, W) uint8; None: all. Where what a
    mask hides is to be the background, it is painted in the photograph. Raises SceneError."""
    valid = photographs.mask_reader(context, obj)()
    if valid is None:
        return None
    valid = resized_valid(valid, photo.shape[1], photo.shape[0])
    if context.scene.svrgs_prune.outside == BACKGROUND:
        photo[valid == 0] = context.scene.svrgs_view.background
        return None
    if not valid.any():
        raise SceneError(tr("the mask of '{name}' hides the whole photograph").format(name=obj.name))
    return valid


def measure(scene, picture, photo, valid) -> dict:
    """Count and bytes of the splat; with a photograph also PSNR, SSIM and FLIP over the pixels that count.
    All fit into a property, where whole numbers have 32 bits."""
    row = {"count": scene.count, "bytes": float(file_size(scene))}
    if photo is not None:
        figures = mean_figures([(covered(picture, valid), covered(photo, valid), valid)])
        row |= {name: figures[name] for name in ("psnr", "ssim", "flip")}
    return row


def covered(picture, valid):
    """The picture, black where it does not count."""
    return picture if valid is None else picture * valid[..., None]


def perceived(pictures: tuple, photo, valid, figures: dict):
    """Measures LPIPS, which takes a minute for a large picture, in a child process, and adds it to the
    figures of the comparison unless there is another one by then."""
    share = 1 - figures.get("hidden", 0.0)

    def done(values, error: str):
        image = bpy.data.images.get(WIPE)
        if image is None or image_pixels.figures_of(WIPE) != figures:
            return
        if error:
            figures["lpips_missing"] = error
        else:
            for name, value in zip(("original", "pruned"), values, strict=True):
                figures[name]["lpips"] = value / share
        image[image_pixels.FIGURES] = figures

    shown = [covered(picture, valid) for picture in pictures]
    work = partial(lpips_in_child, shown, covered(photo, valid), bpy.app.tempdir)
    background_work.run(work, done, detached=True)


def summary(rows: list[dict], between: float, hidden: float) -> str:
    a, b = rows
    texts = [
        tr("{before:,} to {after:,} Gaussians").format(before=a["count"], after=b["count"]),
        tr("{before:.1f} to {after:.1f} MB").format(before=a["bytes"] / 1e6, after=b["bytes"] / 1e6),
        tr("between them {psnr:.1f} dB").format(psnr=between),
    ]
    if "psnr" in a:
        text = tr("against the photograph {before:.2f} to {after:.2f} dB")
        texts.append(text.format(before=a["psnr"], after=b["psnr"]))
    if hidden:
        texts.append(tr("{share:.1%} of it is masked out, and does not count").format(share=hidden))
    return "; ".join(texts)
