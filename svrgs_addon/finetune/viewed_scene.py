"""A scene with the views by which its Gaussians are ranked."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..views.reduced_photos import fitting_reduction

REDUCTION = 2  # views are scored at half their size: nearly the same ranking in a fraction of the time


@dataclass(frozen=True)
class ViewedScene:
    """Gaussians, the cameras that see them, and how they are rendered: what every score is made of."""

    scene: Any  # a Scene or a Model
    cameras: Sequence[Camera]
    rasterizer: Rasterizer
    options: RenderOptions

    @classmethod
    def of(cls, scene: Any, cameras: Sequence[Camera], background=(0.0, 0.0, 0.0)) -> ViewedScene:
        """Rendered as the scene was trained, by a rasterizer of its own. background: display sRGB 0..1."""
        options = RenderOptions(antialiased=scene.antialiased, background=background)
        return cls(scene, cameras, Rasterizer(), options)

    def rendered(self, masks=None, outputs=()) -> Iterator[tuple[Camera, dict[str, np.ndarray]]]:
        """Renders one view after the other. Yields its camera and images; then the rasterizer has its
        statistics. masks, outputs: as of Rasterizer.forward()."""
        for camera in self.cameras:
            yield camera, self.rasterizer.forward(self.scene, camera, self.options, masks, outputs)

    def reduced(self, factor: int = REDUCTION) -> ViewedScene:
        """The same in smaller views."""
        return replace(self, cameras=reduced(self.cameras, factor))


def reduced(cameras: Sequence[Camera], factor: int = REDUCTION) -> list[Camera]:
    """The cameras as views are scored: `factor` times smaller per side, as far as that fits."""
    return [camera.reduced(fitting_reduction(factor, camera.width, camera.height)) for camera in cameras]
