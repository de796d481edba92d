"""Photographs as backgrounds of their cameras. Photographs with lens distortion are undistorted first, by a
child process, which finishes its files also if Blender ends before.

status() says what the last import of cameras lacks, and how far undistorting is.
"""

from __future__ import annotations

from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.views.posed_photos import PosedPhotos, read_in_child
from ..data import background_work, camera_object, known
from ..scene import dataset_paths

_running: list[list[int]] = []  # [photographs done, photographs in all] of each dataset that is undistorted


def begin(problems: tuple[str, ...], root: bpy.types.Object):
    """Sets the problems of a new import of cameras, below `root`; those of the one before are forgotten."""
    for other in known.objects.values():
        other.import_problems.clear()
    known.of(root).import_problems.extend(problems)


def start(
    cameras: list[bpy.types.Object],
    root: bpy.types.Object,
    folder: Path,
    images: str,
    target: Path,
    total: int,
):
    """Undistorts the `total` photographs of the dataset that need it into the folder `target`, then shows
    each as the background of its camera. With a window it returns at once; status() says how far it is and
    what went wrong."""
    uids = {obj.data[camera_object.IMAGE]: obj.session_uid for obj in cameras}  # by image name
    progress, root_uid = [0, total], root.session_uid
    _running.append(progress)

    def tell(*now: int):
        progress[:] = now
        background_work.redraw_soon()

    def done(photos: PosedPhotos, error: str):
        _running[:] = [one for one in _running if one is not progress]
        _show_all(uids, known.of_uid(root_uid).import_problems, photos, error)

    background_work.run(partial(read_in_child, folder, images, target, tell), done, detached=True)


def progress() -> tuple[int, int]:
    """(photographs done, photographs in all) that are being undistorted."""
    return sum(done for done, _ in _running), sum(total for _, total in _running)


def problems() -> str:
    """What is missing or went wrong since the last import of cameras; mostly empty, and so once they are
    deleted."""
    return ". ".join(text for obj in bpy.data.objects for text in known.of(obj).import_problems)


def status() -> str:
    """How many photographs are undistorted, and problems(); mostly empty."""
    done, total = progress()
    text = tr("Undistorting photographs: {done:,} of {total:,}").format(done=done, total=total)
    return ". ".join(filter(None, (text if _running else "", problems())))


def show(obj: bpy.types.Object, file: Path | None):
    """Makes the photograph the background of the camera, unless there is no file or the camera has a
    background."""
    data = obj.data
    if file is None or camera_object.backgrounds(obj):
        return
    background = data.background_images.new()
    background.image = bpy.data.images.load(str(file), check_existing=True)
    background.image.filepath = dataset_paths.stored(str(file))
    background.frame_method, background.alpha = "STRETCH", 1.0
    data.show_background_images = True


def _show_all(uids: dict[str, int], said: list[str], photos: PosedPhotos, error: str):
    """Shows the photographs. Cameras that were deleted since, or belong to a closed file, are skipped. uids:
    session_uid of the camera by the name of its image. said: gets what went wrong."""
    if error:
        text = tr("{error}; the photographs of lenses with distortion are not shown")
        said.append(text.format(error=error))
        return
    said.extend(warning for warning in photos.warnings if warning not in said)
    objects = {obj.session_uid: obj for obj in bpy.data.objects if obj.type == "CAMERA"}
    for camera, file in zip(photos.cameras, photos.files, strict=True):
        if (obj := objects.get(uids.get(camera.name, 0))) is not None:
            show(obj, file)
    if not background_work.waits:
        bpy.ops.ed.undo_push(message="Undistort Photographs")


def unregister():
    _running.clear()
