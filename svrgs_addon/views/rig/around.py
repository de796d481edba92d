"""Cameras evenly all around a scene that is seen from outside. Nothing is rendered, so it takes no time."""

from __future__ import annotations

from ...scene.camera import Camera
from ...scene.gaussians import Scene
from .space import middle_and_radius, sphere, unit_around
from .viewpoints import AROUND, View

DISTANCE = 1.6  # of the cameras from the middle, in half diagonals of the box around the mass


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
    unit = unit_around(scene)
    directions = sphere(count, turn)[:, [0, 2, 1]]  # its axis is vertical
    return [
        View(middle + nearer * DISTANCE * radius * direction, middle, AROUND, unit)
        for direction in directions
    ]
