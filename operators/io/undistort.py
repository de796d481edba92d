"""Photographs as backgrounds of their cameras. Photographs with lens distortion are undistorted first, by a
child process.

status() says what the last import of cameras lacks, and how far undistorting is.
"""

from __future__ import annotations

import threading
from pathlib import Path

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.views.posed_photos import PosedPhotos, read_in_child
from ..data import camera_object
from ..data.child_work import redraw_panels
from ..scene import dataset_paths

INTERVAL = 0.5  # seconds between two looks whether it is done
WAIT = bpy.app.background  # without a window there are no timers, so the operator waits


class UndistortThread(threading.Thread):
    """Waits for the child process that undistorts. It ends with Blender; the process then still finishes its
    files."""

    def __init__(self, cameras: list[bpy.types.Object], folder: Path, images: str, target: Path, total: int):
        super().__init__(daemon=True)
        self.cameras = {obj.data[camera_object.IMAGE]: obj.session_uid for obj in cameras}  # by image name
        self.request = folder, images, target
        self.photos: PosedPhotos | None = None
        self.problems: tuple[str, ...] = ()
        self.error = ""  # why nothing was undistorted
        self.progress = 0, total  # photographs

    def run(self):
        try:
            self.photos = read_in_child(*self.request, tell=self._tell)
            self.problems = self.photos.warnings
        except (SplatError, OSError) as error:
            self.error = str(error)

    def _tell(self, done: int, total: int):
        self.progress = done, total


_threads: list[UndistortThread] = []  # those that run
_problems: list[str] = []  # of the last import of cameras
_root: list[int] = []  # session_uid of the empty above those cameras


def begin(problems: tuple[str, ...], root: bpy.types.Object):
    """Sets the problems of a new import of cameras, below `root`; those of the one before are forgotten."""
    _problems[:], _root[:] = problems, [root.session_uid]


def start(cameras: list[bpy.types.Object], folder: Path, images: str, target: Path, total: int):
    """Undistorts the `total` photographs of the dataset that need it into the folder `target`, then shows
    each as the background of its camera. With a window it returns at once; status() says how far it is and
    what went wrong."""
    _threads.append(UndistortThread(cameras, folder, images, target, total))
    _threads[-1].start()
    if WAIT:
        _threads[-1].join()
        _finish_threads()
    elif not bpy.app.timers.is_registered(_finish_threads):
        bpy.app.timers.register(_finish_threads, first_interval=INTERVAL, persistent=True)


def progress() -> tuple[int, int]:
    """(photographs done, photographs in all) that are being undistorted."""
    return sum(thread.progress[0] for thread in _threads), sum(thread.progress[1] for thread in _threads)


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
                if _threads
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
    if bpy.app.timers.is_registered(_finish_threads):
        bpy.app.timers.unregister(_finish_threads)
    _threads.clear()
    _problems.clear()


def _finish_threads() -> float | None:
    for thread in [thread for thread in _threads if not thread.is_alive()]:
        _threads.remove(thread)
        _finish(thread)
    redraw_panels()
    return INTERVAL if _threads else None


def _finish(thread: UndistortThread):
    """Shows the photographs. Cameras that were deleted since, or belong to a closed file, are skipped."""
    objects = {obj.session_uid: obj for obj in bpy.data.objects if obj.type == "CAMERA"}
    for camera, file in zip(thread.photos.cameras, thread.photos.files, strict=True) if thread.photos else ():
        obj = objects.get(thread.cameras.get(camera.name))
        if obj is not None:
            show(obj, file)
    failed = (
        [tr("{error}; the photographs of lenses with distortion are not shown").format(error=thread.error)]
        if thread.error
        else []
    )
    _problems.extend(problem for problem in (*thread.problems, *failed) if problem not in _problems)
    if thread.photos and not WAIT:
        bpy.ops.ed.undo_push(message="Undistort Photographs")


@persistent
def _after_load(*_):
    """Another file was opened: what was said is about the one before."""
    _problems.clear()


def register():
    bpy.app.handlers.load_post.append(_after_load)


def unregister():
    bpy.app.handlers.load_post.remove(_after_load)
    forget()
