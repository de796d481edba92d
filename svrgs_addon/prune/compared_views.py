"""Photographs beside what the splat shows in their views, reduced: for what is found before pruning."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options
from ..scene.camera import evenly
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.reduced_photos import reduced_view

SIDE = 200  # pixels of the longer side, about
OPAQUE = 0.9  # alpha, from which on a pixel shows the splat and not what is behind it


def compared_views(
    scene: Scene, dataset: Dataset, most: int
) -> Iterator[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """Of at most so many training views, evenly spread: the photograph and the picture, (H, W, 3) float32
    display sRGB, and the pixels in which they can be compared, (H, W) bool: those that count, and that the
    splat fills. Raises FormatError, SceneError."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
    for index in evenly(dataset.train_indices, most):
        camera, photo = reduced_view(dataset.cameras[index], dataset.image(index), SIDE)
        shown = rasterizer.forward(scene, camera, options, outputs=("rgb", "alpha"))
        valid = True if (found := camera.valid) is None else found != 0
        yield photo, shown["rgb"], (shown["alpha"] > OPAQUE) & valid
