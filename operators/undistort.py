"""Photographs as backgrounds of their cameras. Photographs with lens distortion are undistorted first, by a child process."""

from __future__ import annotations

import threading
from pathlib import Path

import bpy

from ..svrgs_addon.blender.posed_photos import read_in_child
from ..svrgs_addon.errors import SplatError
from . import dataset_paths
from .job_watch import redraw_panels

INTERVAL = 0.5  # seconds between two looks whether it is done
WAIT = bpy.app.background  # without a window there are no timers, so the operator waits


class UndistortThread(threading.Thread):
    """Waits for the child process that undistorts. It ends with Blender; the process then still finishes its files."""

    def __init__(self, cameras: list[bpy.types.Object], folder: Path, images: str, target: Path):
        super().__init__(daemon=True)
        self.cameras = [obj.session_uid for obj in cameras]  # in the order of the dataset
        self.request = folder, images, target
        self.files: list[Path | None] = []
        self.problem = ""

    def run(self):
        try:
            self.files = read_in_child(*self.request).files
        except (SplatError, OSError) as error:
            self.problem = f"{error}; the photographs of lenses with distortion are not shown"


_threads: list[UndistortThread] = []  # those that run
_problems: list[str] = []  # of the threads that have ended since the last start()


def start(cameras: list[bpy.types.Object], folder: Path, images: str, target: Path) -> str:
    """Undistorts the photographs of the dataset into the folder `target`, then shows each as the background of its camera.

    Returns what went wrong; with a window it returns at once, and status() says it later.
    """
    _problems.clear()
    _threads.append(UndistortThread(cameras, folder, images, target))
    _threads[-1].start()
    if WAIT:
        _threads[-1].join()
        _finish_threads()
    elif not bpy.app.timers.is_registered(_finish_threads):
        bpy.app.timers.register(_finish_threads, first_interval=INTERVAL, persistent=True)
    return " ".join(_problems)


def status() -> str:
    """That photographs are being undistorted, or what went wrong; mostly empty."""
    return "Undistorting the photographs …" if _threads else " ".join(_problems)


def show(obj: bpy.types.Object, file: Path | None):
    """Makes the photograph the background of the camera, unless there is no file or the camera has a background."""
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
    cameras = {obj.session_uid: obj for obj in bpy.data.objects if obj.type == "CAMERA"}
    for uid, file in zip(thread.cameras, thread.files, strict=False):  # after an error there are no files
        if uid in cameras:
            show(cameras[uid], file)
    if thread.problem:
        _problems.append(thread.problem)
    elif not WAIT:
        bpy.ops.ed.undo_push(message="Undistort Photographs")
