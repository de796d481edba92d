"""A short swing of a view around what it looks at, which shows depth where a still picture does not."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from ...files.images import to_bytes
from ...native.rasterizer import Rasterizer
from ...render.metrics.evaluate import Renderable, picture_options
from ...scene.camera import Camera

FRAMES = 16
ANGLE = math.radians(7)  # to either side
SIDE = 280  # pixels of the longer side of a picture


def swing(scenes: Sequence[Renderable], camera: Camera, background=(0.0, 0.0, 0.0)) -> np.ndarray | None:
    """Pictures of the scenes from the left to the right of a camera, (FRAMES, H, W, 3) uint8; in each, the
    scenes stand side by side. None where the middle of the view is empty. background: display sRGB 0..1."""
    camera, rasterizer = camera.masked(None).fitted(SIDE), Rasterizer()
    distance = _distance(scenes[0], camera, rasterizer)
    if distance is None:
        return None
    picture = lambda scene, view: rasterizer.forward(scene, view, picture_options(scene, background))["rgb"]
    beside = lambda view: np.concatenate([to_bytes(picture(scene, view)) for scene in scenes], axis=1)
    return np.stack([beside(view) for view in cameras(camera, distance)])


def cameras(camera: Camera, distance: float) -> list[Camera]:
    """FRAMES views around the point at this distance in the middle of a view, turned about its vertical axis,
    slower towards both ends."""
    target = camera.position + distance * camera.viewmat[2, :3]
    views = []
    for frame in range(FRAMES):
        angle = -ANGLE * math.cos(math.pi * frame / (FRAMES - 1))
        turn = np.array([
            [math.cos(angle), 0, math.sin(angle)], [0, 1, 0], [-math.sin(angle), 0, math.cos(angle)]
        ])  # fmt: skip
        matrix = np.eye(4)
        matrix[:3, :3] = camera.viewmat[:3, :3].T @ turn @ camera.viewmat[:3, :3]
        matrix[:3, 3] = target - matrix[:3, :3] @ target
        views.append(camera.moved(matrix))
    return views


def _distance(scene: Renderable, camera: Camera, rasterizer: Rasterizer) -> float | None:
    """The mean depth of the middle third of a view; None where it is empty."""
    images = rasterizer.forward(scene, camera, picture_options(scene), outputs=("depth", "alpha"))
    middle = tuple(slice(side // 3, side - side // 3) for side in (camera.height, camera.width))
    alpha = float(images["alpha"][middle].sum())
    return float(images["depth"][middle].sum()) / alpha if alpha > 0 else None
