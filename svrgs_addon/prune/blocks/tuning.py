"""Fine-tunes a pruned scene block by block, on the pictures of the original.

A block is tuned in the views that show it, in the window of each view where it is seen. All Gaussians that
are blended there are tuned with it, but only its own are kept. Steps and rates are those that the whole scene
would have. No block uses the tuned values of another, so any order gives the same bits.

Beside the blocks of the original lie

    cut/     what is left of each block (Divided), and error.json
    tuned/   the same, tuned
    mixed/   the same, interpolated between both
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from pathlib import Path
from statistics import fmean

import numpy as np

from ...files.atomic import write_json
from ...files.reading import json_object
from ...finetune.refit import TrainingView, interpolated, middle_scale, pace_for, refit
from ...finetune.viewed_scene import reduced
from ...render.metrics.evaluate import picture_options, render_options
from ...scene.camera import Camera, evenly
from ...scene.gaussians import PARAMETERS, Scene
from ...system import memory
from ...system.errors import FormatError
from .block_rasterizer import BlockRasterizer
from .discs import Window
from .divided import Divided, Progress, clear, gathered, scene_of, write_block
from .merging import counts, merged
from .scoring import picture_path
from .surroundings import Around

CUT, TUNED, MIXED, ERROR = "cut", "tuned", "mixed", "error.json"  # folders, and a file
ERROR_VIEWS = 8  # in which the error is measured, at most
EPOCHS = 2  # times that each view is shown, if nothing else is asked for


def cut(
    divided: Divided, cameras: Sequence[Camera], wanted: int, progress: Progress = lambda *_: None
) -> Divided:
    """Removes and merges until `wanted` Gaussians are left. Writes what is left of each block, and how large
    the error is in some views. Raises SplatError."""
    emptied(divided, TUNED)
    left = level(divided, wanted, CUT, progress)
    write_json(left.folder / ERROR, {"error": _error(divided, left, reduced(cameras))})
    return left


def level(divided: Divided, wanted: int, name: str, progress: Progress = lambda *_: None) -> Divided:
    """Removes and merges until `wanted` Gaussians are left, and writes what is left of each block into the
    folder `name`. Raises SplatError."""
    return written(divided, merged(divided, counts(divided, wanted), progress), name)


def written(divided: Divided, scenes: Iterable[Scene], name: str) -> Divided:
    """Writes a divided scene into the folder `name`. scenes: the Gaussians of each of its blocks, in the
    order of the blocks. Raises SplatError."""
    folder, start = emptied(divided, name), 0
    for number, scene in enumerate(scenes):
        write_block(folder, number, scene, start)
        start += scene.count
    return gathered(folder, divided)


def emptied(divided: Divided, name: str) -> Path:
    """The folder `name` beside the blocks, without what an earlier run left there."""
    folder = divided.folder / name
    folder.mkdir(exist_ok=True)
    clear(folder)
    return folder


def _error(divided: Divided, left: Divided, views: Sequence[Camera]) -> float:
    """The root mean square error of some views."""
    rasterizer, squares = BlockRasterizer(), []
    for view in evenly(range(len(views)), ERROR_VIEWS):
        picture = rasterizer.forward(left, views[view], picture_options(left))["rgb"]
        difference = picture - _picture(divided, view, views[view])
        squares.append(float(np.square(difference).mean(dtype=np.float64)))
    return fmean(squares) ** 0.5


def tune(
    divided: Divided, number: int, cameras: Sequence[Camera], steps: int, progress: Progress = lambda *_: None
):
    """Tunes a block of what was cut, in so many steps of the whole scene, of which it takes those whose view
    shows it. Raises SplatError."""
    left, views = Divided.read(divided.folder / CUT), reduced(cameras)
    around = Around.of(left, number, views, progress)
    training = [
        _training_view(divided, view, camera, window)
        for view, (camera, window) in enumerate(zip(views, around.windows, strict=True))
    ]
    scene, (first, end) = around.scene, around.own
    refuse_tuning(divided, number, scene, views, sum(one.picture.nbytes for one in training if one))
    middle = middle_scale(np.concatenate([block.geometry[:, 3:6] for block in left.blocks]))
    progress(f"block {number}, {scene.count:,} Gaussians", 0.5)
    pace = pace_for(_error_of(left))
    tuned = refit(scene, training, steps, pace, middle, render_options(scene), 0, lambda: False)
    write_own(left, number, around.there[number], tuned.select(np.arange(first, end)))


def refuse_tuning(divided: Divided, number: int, scene: Scene, views: Sequence[Camera], kept: int):
    """Raises MemoryShort if memory is too short to fine-tune a block with what is around it, in these views.
    kept: bytes of pictures that stay in memory."""
    memory.refuse_excess(
        f"{divided.source}: fine-tuning the {scene.count:,} Gaussians in and around the block {number}",
        memory.tuning(scene.count, divided.coefficients, views, kept),
    )


def _error_of(left: Divided) -> float:
    path = left.folder / ERROR
    try:
        return float((json_object(path, 1 << 16) or {})["error"])
    except (OSError, KeyError, TypeError, ValueError):
        raise FormatError(f"{path}: is missing or damaged; cut the scene again") from None


def mixed(divided: Divided, tuned: Divided, share: float) -> Divided:
    """What was cut, with this share of the tuned scene. It replaces the last one of another share. Raises
    SplatError."""
    left, folder = Divided.read(divided.folder / CUT), divided.folder / MIXED
    if share in (0, 1):
        return tuned if share else left
    folder.mkdir(exist_ok=True)
    for one, other in zip(left.blocks, tuned.blocks, strict=True):
        scene = interpolated(scene_of(left, one), scene_of(tuned, other), share)
        write_block(folder, one.number, scene, int(one.rows[0]))
    return gathered(folder, left)


def tuned_blocks(divided: Divided) -> Divided | None:
    """The tuned scene; None if no block was tuned. Raises SceneError if only some were."""
    folder, left = divided.folder / TUNED, Divided.read(divided.folder / CUT)
    return gathered(folder, left) if any(folder.glob("*.rows")) else None


def _training_view(divided: Divided, view: int, camera: Camera, window: Window | None) -> TrainingView | None:
    if window is None:
        return None
    picture = _picture(divided, view, camera)[window.slices].astype(np.float32)
    return TrainingView(camera, picture, window.slices)


def _picture(divided: Divided, view: int, camera: Camera) -> np.ndarray:
    """(H, W, 3) float16."""
    path = picture_path(divided, view)
    try:
        picture = np.load(path, mmap_mode="r", allow_pickle=False)
    except (OSError, ValueError, EOFError) as error:
        raise FormatError(f"{path}: cannot be read ({error}); score the views first") from None
    if picture.shape != (camera.height, camera.width, 3):
        raise FormatError(f"{path}: is not of this view; score the views again")
    return picture


def write_own(left: Divided, number: int, own: np.ndarray, tuned: Scene):
    """Writes the block with the values of its tuned Gaussians, those marked in own (n,)."""
    scene = scene_of(left, left.blocks[number])
    for name in PARAMETERS:
        getattr(scene, name)[own] = getattr(tuned, name)
    write_block(left.folder.parent / TUNED, number, scene, int(left.blocks[number].rows[0]))
