"""Cameras all around a scene that is seen from outside."""

from __future__ import annotations

import math

import numpy as np

from ..camera import Camera
from ..errors import SceneError
from ..geometry.bounds import robust_box
from ..scene import Scene

FIELD = 0.9  # radians
DISTANCE = 1.6  # of the cameras from the middle, in half diagonals of the box around the mass
GOLDEN = math.pi * (3 - math.sqrt(5))  # turn between two points of a Fibonacci sphere


def middle_and_radius(scene: Scene) -> tuple[np.ndarray, float]:
    """The middle (3,) of the box around the mass of the scene, and half its diagonal. Raises SceneError for a scene without any."""
    opacities = 1 / (1 + np.exp(-np.clip(scene.opacity_logits.astype(np.float64), -80, 80)))
    box = robust_box(scene.means, opacities)
    if box is None:
        raise SceneError("the scene has no Gaussian with a position and an opacity")
    largest = float(np.exp(np.clip(np.median(scene.log_scales.max(axis=1).astype(np.float64)), -80, 80)))
    return box.mean(axis=0), max(float(np.linalg.norm(box[1] - box[0])) / 2, 3 * largest)  # one Gaussian is as large as its scale


def cameras_around(scene: Scene, count: int, side: int, turn: float = 0.0, nearer: float = 1.0) -> list[Camera]:
    """`count` cameras, evenly spread over the whole sphere, that look at the middle of the scene; side: pixels. turn: of all of them around
    the vertical axis, radians; nearer: factor on their distance. Raises SceneError."""
    middle, radius = middle_and_radius(scene)
    focal = side / 2 / math.tan(FIELD / 2)
    K = np.array([[focal, 0, side / 2], [0, focal, side / 2], [0, 0, 1]])
    k = np.arange(count) + 0.5
    height, angle = 1 - 2 * k / count, k * GOLDEN + turn
    level = np.sqrt(1 - height**2)
    directions = np.stack([level * np.cos(angle), height, level * np.sin(angle)], axis=1)
    return [Camera(_looking(middle + nearer * DISTANCE * radius * d, -d), K, side, side, f"around_{i:03d}") for i, d in enumerate(directions)]


def _looking(position: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """World to camera, (4, 4): at this position, along `forward` (3,) of unit length, with y down where that is possible."""
    down = np.array([0.0, 1.0, 0.0]) if abs(forward[1]) < 0.99 else np.array([0.0, 0.0, 1.0])
    right = np.cross(down, forward)
    right /= np.linalg.norm(right)
    viewmat = np.eye(4)
    viewmat[:3, :3] = right, np.cross(forward, right), forward
    viewmat[:3, 3] = -viewmat[:3, :3] @ position
    return viewmat
