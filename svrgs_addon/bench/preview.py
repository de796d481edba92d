"""A scene under a moving camera: every picture is exact, and none is drawn twice."""

from __future__ import annotations

import numpy as np

from ..camera import Camera
from ..geometry.morton_order import morton_order
from ..native import Rasterizer, RenderOptions
from ..scene import Scene


class Preview:
    """Draws one scene again and again. Keeps a copy of it along a Morton curve: what a view sees then lies together."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, level: str | None = None):
        self.options = options or RenderOptions()
        self.scene = scene.select(morton_order(scene.means))
        self._rasterizer = Rasterizer(level)
        self._drawn: tuple[bytes, np.ndarray] | None = None

    def image(self, camera: Camera) -> np.ndarray:
        """Colours (H, W, 3) float32, not clamped; read-only. The picture of a camera that has not moved is the last one."""
        key = camera.key
        if self._drawn is None or self._drawn[0] != key:
            image = self._rasterizer.forward(self.scene, camera, self.options)["rgb"]
            image.flags.writeable = False
            self._drawn = key, image
        return self._drawn[1]
