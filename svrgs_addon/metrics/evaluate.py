"""Quality of a scene against photographs: PSNR, SSIM, FLIP, LPIPS, and how long a frame takes."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Callable, Sequence

import numpy as np

from ..camera import Camera
from ..errors import SceneError
from ..files.images import to_float
from ..native import Rasterizer, RenderOptions
from ..photographs.dataset import Dataset
from ..scene import Scene
from . import flip, psnr, ssim

VISIBLE_CAMERAS = 32  # at most so many cameras are asked whether they see the scene
VISIBLE_POINTS = 100_000
VISIBLE_REACH = 100.0  # times the distance of the outermost camera from the cameras' mean


def shown(rgb: np.ndarray) -> np.ndarray:
    """A rendered image as a viewer's 8 bits hold it: clamped and rounded, (H, W, 3) float32 in 0..1.

    The published protocol measures saved 8-bit files.
    """
    image = np.clip(rgb, 0, 1).astype(np.float32, copy=False)
    image *= 255
    np.round(image, out=image)
    image /= 255
    return image


def render_options(scene: Scene, background=(0.0, 0.0, 0.0), mask_kind: str = "none") -> RenderOptions:
    return RenderOptions(antialiased=scene.antialiased, background=background, mask_kind=mask_kind)


def split_indices(dataset: Dataset, split: str) -> Sequence[int]:
    """Views of 'test', 'train' or 'all'. Raises SceneError if there are none."""
    chosen = {"test": dataset.test_indices, "train": dataset.train_indices, "all": range(len(dataset.cameras))}[split]
    if not len(chosen):
        raise SceneError(f"the dataset has no {split} views")
    return chosen


def mean_psnr(model, dataset: Dataset, indices: Sequence[int], rasterizer: Rasterizer, options: RenderOptions, masks=None) -> float:
    """Mean PSNR in dB over the given views; model: anything with a scene's arrays."""
    values = []
    for i in indices:
        rgb = rasterizer.forward(model, dataset.cameras[i], options, masks)["rgb"]
        values.append(psnr(shown(rgb), to_float(dataset.image(i))))
    return statistics.fmean(values)


def evaluate(scene: Scene, dataset: Dataset, indices: Sequence[int], rasterizer: Rasterizer, lpips: Callable | None = None) -> dict:
    """Means over the views: psnr (dB), ssim, lpips (None without `lpips`), flip; count; ms_per_frame, the median."""
    options = render_options(scene, dataset.background)
    rows, seconds = [], []
    for i in indices:
        photo = to_float(dataset.image(i))
        started = time.perf_counter()
        rgb = rasterizer.forward(scene, dataset.cameras[i], options)["rgb"]
        seconds.append(time.perf_counter() - started)
        image = shown(rgb)
        rows.append((psnr(image, photo), ssim(image, photo), lpips(image, photo) if lpips else math.nan, flip(image, photo)))
    means = np.mean(rows, axis=0)
    return {
        "psnr": float(means[0]),
        "ssim": float(means[1]),
        "lpips": float(means[2]) if lpips else None,
        "flip": float(means[3]),
        "count": scene.count,
        "ms_per_frame": 1e3 * statistics.median(seconds),
    }


def refuse_unseen(scene: Scene, cameras: Sequence[Camera], name: str):
    """Raises SceneError if no camera has a single Gaussian's centre in view and not absurdly far: the files do not belong together."""
    centres = np.array([camera.position for camera in cameras])
    reach = VISIBLE_REACH * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max() or np.inf  # one camera tells no scale
    points = scene.means[:: max(1, scene.count // VISIBLE_POINTS)].astype(np.float64)
    for camera in cameras[:: max(1, len(cameras) // VISIBLE_CAMERAS)]:
        local = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        x, y, z = *camera.pixels(local).T, local[:, 2]
        inside = (z > 0) & (z < reach) & (x >= 0) & (x < camera.width) & (y >= 0) & (y < camera.height)
        if inside.any():
            return
    raise SceneError(f"{name}: none of its Gaussians lies near and in view of any camera; is it in the frame of this COLMAP model?")
