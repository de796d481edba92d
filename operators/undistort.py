"""Photographs behind their cameras: at once those that fit, and those of lenses with distortion when a process has undistorted them."""

from __future__ import annotations

import threading
from pathlib import Path

import bpy

from ..svrgs_addon.blender.posed_photos import read_in_child
from ..svrgs_addon.errors import SplatError
from .job_watch import redraw_panels

EVERY = 0.5  # seconds
WAIT = bpy.app.background  # for the process: without a window there is nothing else to do


class Work(threading.Thread):
    """Undistorts what has to be. Ends with Blender; its process then finishes the files."""

    def __init__(self, cameras: list[bpy.types.Object], folder: Path, images: str, target: Path):
        super().__init__(daemon=True)
        self.cameras = [obj.session_uid for obj in cameras]  # in the order of the dataset
        self.asked = folder, images, target
        self.files: list[Path | None] = []
        self.trouble = ""

    def run(self):
        try:
            self.files = read_in_child(*self.asked).files
        except (SplatError, OSError) as error:
            self.trouble = f"{error}; the photographs of lenses with distortion are not shown"


_works: list[Work] = []
_trouble: list[str] = []  # of works that have ended since the last one began


def start(cameras: list[bpy.types.Object], folder: Path, images: str, target: Path) -> str:
    """Shows all photographs of the dataset's cameras behind them, undistorted in the folder `target`, as soon as they are there.

    Returns what went wrong already.
    """
    _trouble.clear()
    _works.append(Work(cameras, folder, images, target))
    _works[-1].start()
    if WAIT:
        _works[-1].join()
        _look()
    elif not bpy.app.timers.is_registered(_look):
        bpy.app.timers.register(_look, first_interval=EVERY, persistent=True)
    return " ".join(_trouble)


def said() -> str:
    """How it goes on, or what went wrong; empty where there is nothing to say."""
    return "Undistorting the photographs …" if _works else " ".join(_trouble)


def show(obj: bpy.types.Object, file: Path | None):
    """Puts the photograph behind the camera, unless there is one already, or no file."""
    data = obj.data
    if file is None or data.background_images:
        return
    background = data.background_images.new()
    background.image = bpy.data.images.load(str(file), check_existing=True)
    background.frame_method, background.alpha = "STRETCH", 1.0
    data.show_background_images = True


def forget():
    if bpy.app.timers.is_registered(_look):
        bpy.app.timers.unregister(_look)
    _works.clear()
    _trouble.clear()


def _look() -> float | None:
    for work in [work for work in _works if not work.is_alive()]:
        _works.remove(work)
        _finish(work)
        redraw_panels()
    return EVERY if _works else None


def _finish(work: Work):
    """Cameras that were deleted meanwhile, or whose file was closed, go without."""
    there = {obj.session_uid: obj for obj in bpy.data.objects if obj.type == "CAMERA"}
    for uid, file in zip(work.cameras, work.files, strict=False):  # no files where it failed
        if uid in there:
            show(there[uid], file)
    if work.trouble:
        _trouble.append(work.trouble)
    elif not WAIT:
        bpy.ops.ed.undo_push(message="Undistort Photographs")
