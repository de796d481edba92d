"""How much of its photographs a splat explains: whether the two belong together at all."""

from __future__ import annotations

import statistics
from collections.abc import Sequence

import numpy as np

from ...native.rasterizer import Rasterizer
from ...scene.camera import Camera, evenly
from ...views.dataset import Dataset
from ...views.reduced_photos import reduced_view
from .evaluate import Renderable, Renderer, picture_options
from .measures import image_pair, psnr

# Splats of four captures explain 0.82 to 0.98 of their own photographs, and less than -0.6 of those of
# another capture. Objects before a black background explain up to 0.3 of each other.
ENOUGH = 0.5
SAMPLED_VIEWS, SAMPLED_SIDE = 4, 320  # views that are compared, and their longer side in pixels


def explained(image: np.ndarray, photo: np.ndarray, valid: np.ndarray | None = None) -> float:
    """Share of the photograph's variance that the image explains: R² = 1 - Σ (photo - image)² / Σ (photo -
    mean of photo)².

    1: equal images; 0: as good as one colour; below 0: worse. image, photo: (H, W, 3) in [0, 1]. valid:
    (H, W), 0 where pixels do not count; None: all do. A photograph of one colour counts as explained.
    Raises SceneError.
    """
    image, photo = image_pair(image, photo)
    if valid is not None:
        image, photo = image[valid != 0], photo[valid != 0]
    pixels = tuple(range(photo.ndim - 1))
    spread = float(((photo - photo.mean(axis=pixels, dtype=np.float64)) ** 2).sum(dtype=np.float64))
    error = float(((photo - image) ** 2).sum(dtype=np.float64))
    return 1 - error / spread if spread else 1.0


def sample_views(dataset: Dataset) -> list[tuple[Camera, np.ndarray]]:
    """Some views of the dataset and their photographs (H, W, 3) float32, reduced to about SAMPLED_SIDE
    pixels. Raises FormatError, SceneError."""
    chosen = evenly(range(len(dataset.cameras)), SAMPLED_VIEWS)
    return [reduced_view(dataset.cameras[index], dataset.image(index), SAMPLED_SIDE) for index in chosen]


def fit(
    scene: Renderable,
    views: Sequence[tuple[Camera, np.ndarray]],
    background=(0.0, 0.0, 0.0),
    rasterizer: Renderer | None = None,
) -> dict:
    """How well the splat fits photographs: a dict of medians over the views, explained (R²) and psnr (dB).

    views: (camera, photograph (H, W, 3) in [0, 1]), at least one. background: display sRGB 0..1. rasterizer:
    renders the scene; None: native.Rasterizer. Raises SceneError.
    """
    rasterizer, options, rows = rasterizer or Rasterizer(), picture_options(scene, background), []
    for camera, photo in views:
        image = np.clip(rasterizer.forward(scene, camera, options)["rgb"], 0, 1)
        rows.append((explained(image, photo, camera.valid), psnr(image, photo, camera.valid_share)))
    return {
        "explained": statistics.median(row[0] for row in rows),
        "psnr": statistics.median(row[1] for row in rows),
    }


def mismatch(found: dict) -> str:
    """A sentence if the splat does not fit the photographs; empty if it does. found: from fit()."""
    if found["explained"] >= ENOUGH:
        return ""
    share = max(0.0, found["explained"])
    return (
        f"The splat explains only {share:.0%} of its photographs (PSNR {found['psnr']:.1f} dB): it may belong"
        " to another capture, or show only a part of this one"
    )
