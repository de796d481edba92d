"""A dataset whose photographs are renders held in memory: six views of a scene, six 8-bit pictures."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

import scenes
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.dataset import Dataset

WIDTH, HEIGHT = 48, 36
EYES = [(x, y, -4.0) for y in (-0.6, 0.6) for x in (-1.0, 0.0, 1.0)]


@dataclass
class Pictures(Dataset):
    """A dataset whose photographs are in memory."""

    pictures: list[np.ndarray] = field(default_factory=list)

    def image(self, index: int) -> np.ndarray:
        return self.pictures[index]


def photographed(scene: Scene) -> Pictures:
    """8-bit renders of a scene from the cameras at EYES."""
    cameras = [scenes.camera(WIDTH, HEIGHT, eye=eye) for eye in EYES]
    rasterizer = Rasterizer()
    renders = [rasterizer.forward(scene, camera)["rgb"] for camera in cameras]
    pictures = [np.round(np.clip(image, 0, 1) * 255).astype(np.uint8) for image in renders]
    nothing = np.zeros((0, 3))
    return Pictures(
        cameras,
        nothing.astype(np.float32),
        nothing.astype(np.uint8),
        list(range(len(EYES))),
        [],
        pictures=pictures,
    )
