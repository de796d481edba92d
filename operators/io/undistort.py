"""Photographs as backgrounds of their cameras. Photographs with lens distortion are undistorted first, by a
child process.

status() says what the last import of cameras lacks, and how far undistorting is.
"""

from __future__ import annotations

from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.views.posed_photos import PosedPhotos, read_in_child
from ..data import camera_object
from ..data.child_work import ChildWork, redraw_panels
from ..scene import dataset_paths

INTERVAL = 0.5  # seconds between two looks whether it is done


class Undistorting:
    """One dataset whose photographs a child process undistorts. It finishes its files also if Blender ends
    before."""

    def __init__(self, cameras: list[bpy.types.Object], folder: Path, images: str, target: Path, total: int):
        self.cameras = {obj.data[camera_object.IMAGE]: obj.session_uid for obj in cameras}  # by image name
        self.request = folder, images, target
        self.photos: PosedPhotos | None = None
        self.error = ""  # why nothing was undistorted
        self.progress = 0, total  # photographs
        self.ended = False

    def run(self):
        """In a thread, which must not use bpy."""
        try:
            self.photos = read_in_child(*self.request, tell=self._tell)
        except (SplatError, OSError) as error:
            self.error = str(error)
        finally:
            self.ended = True

    def _tell(self, done: int, total: int):
        self.progress = done, total


_running: list[Undistorting] = []
_problems: list[str] = []  # of the last import of cameras
_root: list[int] = []  # session_uid of the empty above those cameras


def begin(problems: tuple[str, ...], root: bpy.types.Object):
    """Sets the problems of a new import of cameras, below `root`; those of the one before are forgotten."""
    _problems[:], _root[:] = problems, [root.session_uid]


def start(cameras: list[bpy.types.Object], folder: Path, images: str, target: Path, total: int):
    """Undistorts the `total` photographs of the dataset that need it into the folder `target`, then shows
    each as the background of its camera. With a window it returns at once; status() says how far it is and
    what went wrong."""
    _running.append(Undistorting(cameras, folder, images, target, total))
    _child_work.start(_running[-1].run)


def progress() -> tuple[int, int]:
    """(photographs done, photographs in all) that are being undistorted."""
    return sum(one.progress[0] for one in _running), sum(one.progress[1] for one in _running)


def problems() -> str:
    """What is missing or went wrong since the last import of cameras; mostly empty, and so once they are
    deleted."""
    return ". ".join(_problems) if any(obj.session_uid in _root for obj in bpy.data.objects) else ""


def status() -> str:
    """How many photographs are undistorted, and problems(); mostly empty."""
    done, total = progress()
    return ". ".join(
        filter(
            None,
            [
                tr("Undistorting photographs: {done:,} of {total:,}").format(done=done, total=total)
                if _running
                else "",
                problems(),
            ],
        )
    )


def show(obj: bpy.types.Object, file: Path | None):
    """Makes the photograph the background of the camera, unless there is no file or the camera has a
    background."""
    data = obj.data
    if file is None or data.background_images:
        return
    background = data.background_images.new()
    background.image = bpy.data.images.load(str(file), check_existing=True)
    background.image.filepath = dataset_paths.stored(str(file))
    background.frame_method, background.alpha = "STRETCH", 1.0
    data.show_background_images = True


def forget():
    """Stops waiting. The threads end by themselves."""
    _child_work.close()
    _running.clear()
    _problems.clear()


def _finished():
    for one in [one for one in _running if one.ended]:
        _running.remove(one)
        _finish(one)


def _finish(one: Undistorting):
    """Shows the photographs. Cameras that were deleted since, or belong to a closed file, are skipped."""
    objects = {obj.session_uid: obj for obj in bpy.data.objects if obj.type == "CAMERA"}
    photos = one.photos
    for camera, file in zip(photos.cameras, photos.files, strict=True) if photos else ():
        obj = objects.get(one.cameras.get(camera.name))
        if obj is not None:
            show(obj, file)
    failed = (
        [tr("{error}; the photographs of lenses with distortion are not shown").format(error=one.error)]
        if one.error
        else []
    )
    _problems.extend(
        problem for problem in (*(photos.warnings if photos else ()), *failed) if problem not in _problems
    )
    if photos and not _child_work.waits:
        bpy.ops.ed.undo_push(message="Undistort Photographs")


_child_work = ChildWork(_finished, redraw_panels, INTERVAL, detached=True)


@persistent
def _after_load(*_):
    """Another file was opened: what was said is about the one before."""
    _problems.clear()


HANDLERS = {"load_post": _after_load}


def unregister():
    forget()
