"""Distractors: what stood in one photograph and not in the others, such as people who walked by.

Every Gaussian has a mean residual: of the pixels that show it, in all other views, weighted by alpha T.
Rendered like a colour, it is what the splat errs in a view where nothing moved. A pixel that errs much more
is an outlier; as in RobustNeRF (Sabour et al. 2023), it is a distractor where a 3 x 3 neighbourhood, and then
a patch, are full of them. The splat itself may have been trained on the distractors.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

import numpy as np

from ..files.images import write_image
from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import render_options
from ..scene.camera import Camera
from ..scene.gaussians import SH_C0, Scene
from ..system.errors import SceneError
from ..system.foreign import own
from ..views.dataset import Dataset
from ..views.reduced_photos import reduced_view
from .compared_views import SIDE

TIMES, MORE = 3.0, 0.03  # an outlier errs by so many times the expected residual, and so much more, of 0..1
SEEN = 1.0  # sum of alpha T, from which on other views say what a Gaussian errs
FILLED = 0.5  # alpha: where the splat shows less, it is not known what is there
DARK = 0.05  # of 0..1: darker colours say nothing about exposure
NEIGHBOURS, PATCH = 3, 9  # sides in pixels of a reduced picture
SHARES = 0.5, 0.3  # of outliers, from which on a neighbourhood and a patch count


def without_distractors(scene: Scene, dataset: Dataset) -> tuple[Dataset, str]:
    """The dataset in whose training views distractors do not count, and a sentence for the user. Raises
    FormatError, SceneError."""
    cameras, shares, hidden = list(dataset.cameras), dict[int, float](), list[str]()
    for index, found in distractors_of(scene, dataset).items():
        before = cameras[index]
        if found.any():
            valid = ~_resized(found, before)
            cameras[index] = before.masked(valid if before.valid is None else valid & (before.valid != 0))
        shares[index] = before.valid_share - cameras[index].valid_share
        hidden += [before.name] if not cameras[index].valid_share else []
    left = [index for index in dataset.train_indices if cameras[index].name not in hidden]
    if not left:
        raise SceneError("every photograph is full of distractors: leave out --mask-distractors")
    most = max(shares, key=lambda index: shares[index])
    sentence = (
        f"distractors cover {np.mean(list(shares.values())):.1%} of the photographs, at most"
        f" {shares[most]:.1%} of one ({cameras[most].name}), and do not count there"
    )
    sentence += f"; nothing is left of {', '.join(hidden)}" if hidden else ""
    return replace(dataset, cameras=cameras, train_indices=left, _cache={}), sentence


def folder_of(out: Path) -> Path:
    """Where the masks of a result are written."""
    return out.with_name(f"{out.name}_distractor_masks")


def write_masks(folder: Path, cameras: Sequence[Camera]):
    """Writes what counts in each photograph, as COLMAP's masks: NAME.png, 0 where it does not. So `--masks`
    reads them. Raises SceneError, and FormatError if a link is on the way."""
    for camera in cameras:
        valid, file = camera.valid, PurePosixPath(f"{camera.name}.png")
        white = np.full((camera.height, camera.width), 255, np.uint8)
        path = own(folder.parent, folder.name, *file.parts)
        write_image(path, white if valid is None else white * valid)


def _resized(marked: np.ndarray, camera: Camera) -> np.ndarray:
    """The marks (h, w) of a reduced view in the view, (H, W)."""
    sides = zip((camera.height, camera.width), marked.shape, strict=True)
    rows, columns = (np.arange(new) * old // new for new, old in sides)
    return marked[rows][:, columns]


def distractors_of(scene: Scene, dataset: Dataset) -> dict[int, np.ndarray]:
    """Where distractors are in each training view, bool, of its size in compared_views."""
    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    grey = replace(scene, sh=np.zeros((scene.count, 1, 3), np.float32))
    black = replace(options, background=(0.0, 0.0, 0.0), picture_only=True)

    def shares(camera: Camera, error: np.ndarray) -> np.ndarray:
        """(2, N): the sums of alpha T times the error, and of alpha T, over the pixels of a view."""
        sums = np.zeros((2, scene.count))
        rasterizer.forward(grey, camera, options)
        rows = rasterizer.backward({"rgb": np.repeat(error[..., None], 3, axis=2)}, ("sh",))["sh"]
        sums[0, rasterizer.visible()] = rows[:, 0, 0] / SH_C0
        rasterizer.add_scores(sums[1])
        return sums

    views, sums = dict[int, tuple[Camera, np.ndarray]](), np.zeros((2, scene.count))
    for index in dataset.train_indices:
        camera, photo = reduced_view(dataset.cameras[index], dataset.image(index), SIDE)
        views[index] = camera, _error(rasterizer.forward(scene, camera, options)["rgb"], photo)
        sums += shares(*views[index])
    found = {}
    for index, (camera, error) in views.items():
        errors, weights = sums - shares(camera, error)  # of the other views
        means = np.where(weights > SEEN, errors / np.maximum(weights, SEEN), 1.0)
        colours = ((means - 0.5) / SH_C0).astype(np.float32)
        expected = replace(scene, sh=np.repeat(colours[:, None, None], 3, axis=2))
        shown = rasterizer.forward(expected, camera, black, outputs=("rgb", "alpha"))
        alpha = np.maximum(shown["alpha"], FILLED)
        outliers = error > TIMES * shown["rgb"][..., 0] / alpha + MORE
        found[index] = _patches(outliers & (shown["alpha"] >= FILLED))
    return found


def _error(picture: np.ndarray, photo: np.ndarray) -> np.ndarray:
    """The mean absolute difference of the channels, (H, W), after each was multiplied by the median ratio,
    which distractors do not change: exposure does not count."""
    bright = [picture[..., k] > DARK for k in range(3)]
    gains = [
        np.median(photo[one, k] / picture[one, k]) if one.any() else np.float32(1)
        for k, one in enumerate(bright)
    ]
    return np.abs(photo - np.stack(gains) * picture).mean(axis=2, dtype=np.float32)


def _patches(outliers: np.ndarray) -> np.ndarray:
    """The pixels (H, W) whose neighbourhood, and then whose patch, is full of outliers, and those beside
    them."""
    for side, share in zip((NEIGHBOURS, PATCH), SHARES, strict=True):
        outliers = _share_around(outliers, side) >= share
    return _share_around(outliers, NEIGHBOURS) > 0


def _share_around(marked: np.ndarray, side: int) -> np.ndarray:
    """The share of marked pixels in the square of this side around each, (H, W)."""
    padded = np.pad(marked.astype(np.float64), side // 2, mode="edge")
    sums = np.pad(padded, ((1, 0), (1, 0))).cumsum(axis=0).cumsum(axis=1)
    return (sums[side:, side:] - sums[:-side, side:] - sums[side:, :-side] + sums[:-side, :-side]) / side**2
