"""A scene under a moving camera. Every picture is exact; a picture of an unmoved camera is not rendered
again."""

from __future__ import annotations

import numpy as np

from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.scene.morton_order import morton_order


class Preview:
    """Renders one scene repeatedly. It keeps a copy in Morton order, so that the Gaussians of a view are near
    each other in memory."""

    def __init__(self, scene: Scene, options: RenderOptions | None = None, level: str | None = None):
        self.options = options or RenderOptions(picture_only=True)
        self.scene = scene.select(morton_order(scene.means))
        self._rasterizer = Rasterizer(level)
        self._drawn: tuple[bytes, np.ndarray] | None = None

    def image(self, camera: Camera) -> np.ndarray:
        """Colours (H, W, 3) float32, not clamped, read-only. If the camera has not moved, it returns the last
        picture."""
        key = camera.key
        if self._drawn is None or self._drawn[0] != key:
            image = self._rasterizer.forward(self.scene, camera, self.options)["rgb"]
            image.flags.writeable = False
            self._drawn = key, image
        return self._drawn[1]
