"""Other numbers of Gaussians of a quick result than its job left: the job has kept the order of its removals
and merges (finetune/decimate/saved_order.py).

The data of the splat stay those of the job. What is drawn, compared, exported and applied has the number that
the slider Keep shows.
"""

from __future__ import annotations

import os
from concurrent.futures import Future
from dataclasses import dataclass
from functools import partial

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import read_scene
from ...svrgs_addon.finetune.decimate.saved_order import ORDER, SavedOrder, read_order
from ...svrgs_addon.jobs.job_folder import JobFolder
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.moved_points import common_motion
from ...svrgs_addon.system.errors import SceneError, SplatError
from . import background_work, job_paths, known, pairs, splat_object

# property of a pruned splat: the number of Gaussians that is shown instead of the job's own
SHOWN = "svrgs_shown"
# property of a pruned splat: name of the folder of its job. After an undo its original may have another job
JOB = "svrgs_order"
# Gaussians of the original up to which an order is read before it is needed: it takes memory
MOST_AHEAD = 1_000_000


@dataclass(frozen=True)
class _Read:
    """An order that was read, in the coordinates of its splat."""

    folder: str
    positions: np.ndarray  # of the splat's points at that time
    order: SavedOrder


_ahead: dict[str, Future] = {}  # by folder, at most one: its order, while it is read
_last: list[_Read] = []  # at most one: an order takes as much memory as the original and as much again


def read_ahead(folder: JobFolder):
    """Begins to read the order of a job, if it has kept one, in a thread: the first position of the slider
    need not wait for it."""
    if bpy.app.background or not os.path.isfile(folder / ORDER) or folder.request()["count"] > MOST_AHEAD:
        return
    forget()
    _ahead[str(folder.path)] = background_work.run(partial(_files, folder))


def available(pruned: bpy.types.Object) -> bool:
    """Whether other numbers can be shown."""
    folder = _folder(pruned)
    return bool(folder) and not known.of(pruned).order_problem and not pruned.modifiers


def problem(pruned: bpy.types.Object) -> str:
    """Why other numbers cannot be shown although the job has kept an order; empty if they can, or if it has
    kept none."""
    folder = _folder(pruned)
    if folder and pruned.modifiers:
        text = tr("Remove the modifiers of '{name}' to show other numbers of Gaussians")
        return text.format(name=pruned.name)
    if SHOWN in pruned and not folder:
        return tr("the files of the job are gone, so other numbers of Gaussians cannot be shown")
    return known.of(pruned).order_problem if folder else ""


def show(pruned: bpy.types.Object, count: int, own: int):
    """Shows `count` Gaussians, or as many as there can be. own: those of the job, which are shown as it left
    them."""
    if abs(count - own) <= 1 + own // 2**22:  # a percentage is a float32
        pruned.pop(SHOWN, None)
    elif available(pruned):
        try:
            pruned[SHOWN] = _order(pruned).clipped(count)
        except SplatError as error:
            known.of(pruned).order_problem = str(error)
            pruned.pop(SHOWN, None)
    pruned.data.update_tag()


def is_shown(pruned: bpy.types.Object) -> bool:
    """Whether another number than the job's own is shown."""
    return SHOWN in pruned and available(pruned)


def count(obj: bpy.types.Object) -> int:
    """Number of Gaussians of a splat; of a quick result, of those that are shown."""
    return obj[SHOWN] if is_shown(obj) else splat_object.count(obj)


def shown(pruned: bpy.types.Object) -> Scene | None:
    """The Gaussians that are shown instead of the splat's own; None: its own are shown. Raises SplatError."""
    return _order(pruned).at(pruned[SHOWN]) if is_shown(pruned) else None


def _folder(pruned: bpy.types.Object) -> str:
    """The folder of the splat's job, if it has kept an order; else empty."""
    folder = job_paths.folder_of(pairs.original_of(pruned))
    if os.path.basename(folder) == pruned.get(JOB) and os.path.isfile(os.path.join(folder, ORDER)):
        return folder
    return ""


def _order(pruned: bpy.types.Object) -> SavedOrder:
    """The order of the splat's job, moved as the splat's points were. Raises FormatError, SceneError."""
    folder = JobFolder(_folder(pruned))
    positions = splat_object.stored_values(pruned, "position")
    if _last and _last[0].folder == str(folder.path) and np.array_equal(_last[0].positions, positions):
        return _last[0].order
    _last.clear()
    reading = _ahead.pop(str(folder.path), None)
    means, order = reading.result() if reading else _files(folder)
    motion = common_motion(means, positions) if means.shape == positions.shape else None
    if motion is None:
        text = tr("points of '{name}' were edited, so other numbers of Gaussians cannot be shown")
        raise SceneError(text.format(name=pruned.name))
    order = order.moved(motion)
    _last.append(_Read(str(folder.path), positions, order))
    return order


def _files(folder: JobFolder) -> tuple[np.ndarray, SavedOrder]:
    """The positions (N, 3) of the job's result, and its order; both as in the files. Raises FormatError,
    SceneError."""
    return read_scene(folder / "pruned.ply").means, read_order(folder.path, read_scene(folder / "scene.ply"))


def forget(*_):
    """Frees the memory of what was read."""
    _last.clear()
    _ahead.clear()
