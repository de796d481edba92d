"""Photographs beside what the splat shows in their views, reduced: for what is found before pruning."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options
from ..scene.camera import Camera, evenly
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.reduced_photos import photo_of

SIDE = 200  # pixels of the longer side, about


def compared_views(
    scene: Scene, dataset: Dataset, most: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray | None]]:
    """Of at most so many training views, evenly spread: the photograph and the picture, (H, W, 3) float32
    display sRGB, and the pixels that count (Camera.valid). Raises FormatError, SceneError."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
    for index in evenly(dataset.train_indices, most):
        factor = reduction(dataset.cameras[index])
        camera = dataset.cameras[index].reduced(factor)
        photo = photo_of(camera, dataset.image(index), np.dtype(np.float32), factor)
        yield photo, rasterizer.forward(scene, camera, options)["rgb"], camera.valid


def reduction(camera: Camera) -> int:
    """By what a view is reduced so that its longer side has about SIDE pixels."""
    return camera.reducible(max(1, max(camera.width, camera.height) // SIDE))
