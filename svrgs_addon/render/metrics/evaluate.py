"""Quality of a scene compared with photographs: PSNR, SSIM, FLIP, LPIPS; and the time per frame."""

from __future__ import annotations

import itertools
import math
import statistics
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from typing import Any, Protocol

import numpy as np

from ...files.images import to_float
from ...native.library import near_depth
from ...native.rasterizer import Rasterizer, RenderOptions
from ...scene.camera import Camera, evenly
from ...system.errors import SceneError
from ...views.dataset import Dataset
from ..pose_alignment import aligned
from . import flip_map, psnr, ssim
from .allowed_loss import EQUAL
from .colour_match import colour_matched
from .lpips import default_lpips
from .measures import with_error

# Limits of refuse_unseen() and any_in_view().
VISIBLE_CAMERAS = 32  # approximate number of cameras that are checked, evenly spaced in the list
VISIBLE_POINTS = 100_000  # approximate number of Gaussians that are checked
# largest z, as a multiple of the largest distance of a camera from the mean of the cameras, and of a unit
VISIBLE_REACH = 100.0
TIMED_ROUNDS = 5  # of frame_milliseconds()
# of LPIPS as an allowed loss: views, the side of the square in each, and how far the squares of two views are
# apart, as shares of height and width: they are all over the picture (multiples of two irrational numbers)
BLOCKS, BLOCK, PLACES = 8, 192, (0.7549, 0.5698)


class Renderable(Protocol):
    """A scene: in memory (scene.gaussians.Scene), or larger than that (prune.blocks.divided.Divided)."""

    @property
    def count(self) -> int: ...

    @property
    def antialiased(self) -> bool: ...

    @property
    def means(self) -> np.ndarray:
        """(n, 3), of all its Gaussians or of some all over it."""


class Renderer(Protocol):
    """Renders a scene: a Rasterizer, or prune.blocks.block_rasterizer.BlockRasterizer a divided one."""

    @property
    def forward(self) -> Callable[..., dict[str, Any]]: ...


def rounded_to_8_bits(rgb: np.ndarray) -> np.ndarray:
    """A rendered image (H, W, 3), clamped to 0..1 and rounded to multiples of 1/255, float32: published
    results are measured on saved 8-bit files."""
    image = np.clip(rgb, 0, 1).astype(np.float32, copy=False)
    image *= 255
    np.round(image, out=image)
    image /= 255
    return image


def render_options(scene: Renderable, background=(0.0, 0.0, 0.0), mask_kind: str = "none") -> RenderOptions:
    """To render the scene as it was trained. background: display sRGB 0..1. mask_kind: form of F."""
    return RenderOptions(antialiased=scene.antialiased, background=background, mask_kind=mask_kind)


def picture_options(scene: Renderable, background=(0.0, 0.0, 0.0), mask_kind: str = "none") -> RenderOptions:
    """The same for a picture of which neither gradients nor statistics are needed."""
    return replace(render_options(scene, background, mask_kind), picture_only=True)


def split_indices(dataset: Dataset, split: str) -> Sequence[int]:
    """Indices of the views of split 'test', 'train' or 'all'. Raises SceneError if there are none."""
    everything = range(len(dataset.cameras))
    chosen = {"test": dataset.test_indices, "train": dataset.train_indices, "all": everything}[split]
    if not len(chosen):
        raise SceneError(f"the dataset has no {split} views; choose another split")
    return chosen


def mean_quality(
    model,
    dataset: Dataset,
    indices: Sequence[int],
    rasterizer: Rasterizer,
    options: RenderOptions,
    masks=None,
    measure: str = "psnr",
    error: float = 0.0,
) -> float:
    """Mean quality_of_view() over the given views: PSNR in dB, or what else an allowed loss is taken from; of
    LPIPS, which takes long, over some of them. model: an object with the arrays of Scene. masks: (N,) uint8,
    None: all 1. measure, error: as there. Raises SceneError, FormatError."""
    values, options = [], replace(options, picture_only=True)
    for number, i in enumerate(evenly(indices, BLOCKS) if measure == "lpips" else indices):
        camera = dataset.cameras[i]
        image = rounded_to_8_bits(rasterizer.forward(model, camera, options, masks)["rgb"])
        photo = to_float(dataset.image(i))
        values.append(quality_of_view(image, photo, camera, measure, error, number))
    return mean_psnr(values) if measure == "psnr" else statistics.fmean(values)


def quality_of_view(
    image: np.ndarray, photo: np.ndarray, camera: Camera, measure: str, error: float, number: int
) -> float:
    """The higher the better: PSNR in dB, or minus FLIP, or minus LPIPS of a block, of the pixels that count;
    0 for a block without any. image, photo: (H, W, 3) in 0..1. measure: a key of MEASURES. error: mean
    squared error that is added, colours in 0..1, for PSNR. number: of the view, for the place of the block.
    Raises SceneError if the weights of LPIPS are missing."""
    if measure == "psnr":
        return with_error(psnr(image, photo, camera.valid_share), error)
    valid = camera.valid
    if measure == "lpips":
        share = 1.0 if valid is None else float(block(valid, number).mean())
        return -default_lpips()(block(image, number), block(photo, number)) / share if share else 0.0
    return -_mean_flip(image, photo, valid)


def _mean_flip(image: np.ndarray, photo: np.ndarray, valid: np.ndarray | None) -> float:
    """Of the pixels that count."""
    flips = flip_map(image, photo)
    return float((flips if valid is None else flips[valid != 0]).mean(dtype=np.float64))


def block(picture: np.ndarray, number: int) -> np.ndarray:
    """A square of at most BLOCK pixels a side, each number at another place. picture: (H, W, ...)."""
    spare = (max(0, side - BLOCK) for side in picture.shape[:2])
    top, left = (round(number * step % 1 * room) for step, room in zip(PLACES, spare, strict=True))
    return picture[top : top + BLOCK, left : left + BLOCK]


def evaluate(
    scene: Renderable,
    dataset: Dataset,
    indices: Sequence[int],
    rasterizer: Renderer,
    lpips: Callable | None = None,
    matched: bool = False,
    moved: bool = False,
) -> dict:
    """Renders the views and compares them with the photographs.

    Returns means over the views: psnr (dB), ssim, flip, lpips (None without `lpips`), all None without views;
    with `matched` also psnr_matched, the PSNR in the colours of the photographs (colour_match.py); with
    `moved` psnr_aligned, after each view was moved to where the scene shows its photograph
    (pose_alignment.py); and count (Gaussians), ms_per_frame (median duration of a forward pass in
    milliseconds; None for a divided scene, which is read for each view, and without views).
    """
    options = picture_options(scene, dataset.background)
    seconds: list[float] = []
    asked = {"psnr_matched": matched, "psnr_aligned": moved}
    further: dict[str, list[float]] = {name: [] for name in asked if asked[name]}

    def pair(i: int) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
        started = time.perf_counter()
        rgb = rasterizer.forward(scene, dataset.cameras[i], options)["rgb"]
        seconds.append(time.perf_counter() - started)
        image, stored, camera = rounded_to_8_bits(rgb), dataset.image(i), dataset.cameras[i]
        photo = to_float(stored)
        if matched:
            same = colour_matched(image, photo, camera.valid)
            further["psnr_matched"].append(psnr(same, photo, camera.valid_share))
        if moved:
            view = aligned(scene, camera, stored, rasterizer, options).camera()
            shown = rounded_to_8_bits(rasterizer.forward(scene, view, options)["rgb"])
            further["psnr_aligned"].append(psnr(shown, photo, camera.valid_share))
        return image, photo, camera.valid

    figures = mean_figures(map(pair, indices), lpips)
    figures |= {name: mean_psnr(values) if values else None for name, values in further.items()}
    timed = seconds and isinstance(rasterizer, Rasterizer)
    return {
        **figures,
        "count": scene.count,
        "ms_per_frame": 1e3 * statistics.median(seconds) if timed else None,
    }


def mean_psnr(values: Sequence[float]) -> float:
    """Mean of PSNR in dB. Equal pictures count as EQUAL, unless all are equal: then it is infinite."""
    return math.inf if min(values) == math.inf else statistics.fmean(min(value, EQUAL) for value in values)


def mean_figures(
    pairs: Iterable[tuple[np.ndarray, np.ndarray, np.ndarray | None]],
    lpips: Callable | None = None,
    most: float = math.inf,
) -> dict[str, float | None]:
    """Means over pairs of pictures: psnr (dB: mean_psnr(), at most `most`), ssim, lpips (None without
    `lpips`), flip; all None without pairs. pairs: two pictures, and where their pixels count, (H, W), None:
    everywhere; elsewhere both are 0. PSNR and FLIP are means over the pixels that count; SSIM and LPIPS find
    no error elsewhere, but for windows at the border, and what they find is divided by the share that counts.
    Raises SceneError."""
    rows = []
    for image, photo, valid in pairs:
        share = 1.0 if valid is None else float(valid.mean())
        rows.append((
            psnr(image, photo, share),
            1 - (1 - ssim(image, photo)) / share,
            lpips(image, photo) / share if lpips else math.nan,
            _mean_flip(image, photo, valid),
        ))  # fmt: skip
    means: list[float | None] = [None] * 4
    if rows:
        means = [min(mean_psnr([row[0] for row in rows]), most), *np.mean(rows, axis=0).tolist()[1:]]
    return dict(zip(("psnr", "ssim", "lpips", "flip"), means, strict=True)) | (
        {} if lpips else {"lpips": None}
    )


def frame_milliseconds(scenes: Sequence[Any], cameras: Sequence[Camera]) -> list[float]:
    """Milliseconds to render one view of each scene: medians over TIMED_ROUNDS rounds of all views, in which
    the scenes take turns, so that what else the machine does falls on all of them. scenes: in memory."""
    rasterizer, rows = Rasterizer(), list[list[float]]()
    for camera in [camera for _ in range(TIMED_ROUNDS) for camera in cameras]:
        started = [time.perf_counter()]
        for scene in scenes:
            rasterizer.forward(scene, camera, picture_options(scene))
            started.append(time.perf_counter())
        rows.append([1e3 * (end - start) for start, end in itertools.pairwise(started)])
    return [statistics.median(column) for column in zip(*rows, strict=True)]


def refuse_unseen(scene: Renderable, cameras: Sequence[Camera], name: str):
    """Raises SceneError, naming the scene's file, if no camera sees the centre of a Gaussian within
    VISIBLE_REACH: scene and cameras do not belong together."""
    some = cameras[:: max(1, len(cameras) // VISIBLE_CAMERAS)]
    if not any_in_view(scene.means, cameras, some):
        near = max(near_depth(camera.unit) for camera in some)
        raise SceneError(
            f"{name}: none of its Gaussians is near a camera and in view of it, more than {near:g} in front;"
            " use the cameras of this scene"
        )


def any_in_view(points: np.ndarray, cameras: Sequence[Camera], some: Sequence[Camera]) -> bool:
    """Whether one of the cameras `some` sees one of the points (N, 3), world, where it would be rendered, and
    within VISIBLE_REACH. cameras: all, for the scale. Of many points, about VISIBLE_POINTS are checked."""
    centres = np.array([camera.position for camera in cameras])
    spread = np.linalg.norm(centres - centres.mean(axis=0), axis=1).max()
    # a single camera gives no scale, and a shot that hardly moves one that is too small
    reach = VISIBLE_REACH * max(spread, min(1.0, cameras[0].unit)) if spread else np.inf
    points = points[:: max(1, len(points) // VISIBLE_POINTS)].astype(np.float64)
    for camera in some:
        local = camera.local(points)
        if (camera.shows(local) & (local[:, 2] > near_depth(camera.unit)) & (local[:, 2] < reach)).any():
            return True
    return False
