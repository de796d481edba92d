"""Cameras evenly all around a scene that is seen from outside. Nothing is rendered, so it takes no time."""

from __future__ import annotations

import math

import numpy as np

from ...scene.bounds import robust_box
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from ...system.errors import SceneError
from .space import sphere
from .viewpoints import AROUND_FOV, View

DISTANCE = 1.6  # of the cameras from the middle, in half diagonals of the box around the mass


def middle_and_radius(scene: Scene) -> tuple[np.ndarray, float]:
    """Middle (3,) and half diagonal of the box around the scene's mass. Raises SceneError without mass."""
    opacities = 1 / (1 + np.exp(-np.clip(scene.opacity_logits.astype(np.float64), -80, 80)))
    box = robust_box(scene.means, opacities)
    if box is None:
        raise SceneError("the scene has no Gaussian with a position and an opacity")
    largest = float(np.exp(np.clip(np.median(scene.log_scales.max(axis=1).astype(np.float64)), -80, 80)))
    # one Gaussian is as large as its scale
    return box.mean(axis=0), max(float(np.linalg.norm(box[1] - box[0])) / 2, 3 * largest)


def cameras_around(
    scene: Scene, count: int, side: int, turn: float = 0.0, nearer: float = 1.0
) -> list[Camera]:
    """`count` cameras on a sphere around the scene that look at its middle; pictures are side x side pixels.
    turn: of all cameras around the vertical axis, radians. nearer: factor on their distance. Raises
    SceneError."""
    views = views_around(scene, count, turn, nearer)
    return [view.camera(side, f"around_{number:03}") for number, view in enumerate(views)]


def views_around(scene: Scene, count: int, turn: float = 0.0, nearer: float = 1.0) -> list[View]:
    """The views of cameras_around()."""
    middle, radius = middle_and_radius(scene)
    directions = sphere(count, turn)[:, [0, 2, 1]]  # its axis is vertical
    return [
        View(middle + nearer * DISTANCE * radius * direction, middle, math.tan(AROUND_FOV / 2))
        for direction in directions
    ]
