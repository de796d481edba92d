"""What a page shows, and where it looks from."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..prune.selection.measure import BY_VIEWS, RANK, VIEWS
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..scene.upright import up_direction
from ..views.dataset import Dataset
from ..views.rig.space import unit_around

UP = np.array([0.0, -1.0, 0.0])  # of a splat without cameras, as in most files
# columns of a measured file (prune/selection/measure.py) that colours can show
COLUMNS = {"Removal error, as a rank": RANK, "Deciding views": VIEWS, "Rank spread over views": BY_VIEWS}
# without cameras, where the first view is from, in distances that hold 80 % of the means; and how near to a
# camera what it turns about may be, in Camera.unit
START, NEAREST = np.array([0.0, -0.8, -1.8]), 0.1
FOV = math.radians(50)  # of the first view without cameras


@dataclass(frozen=True)
class View:
    """Where one looks from: the vertical field of view in radians, and in world coordinates the position, the
    point in the middle that the view turns about, and the direction up, (3,) each."""

    fov: float
    position: np.ndarray
    target: np.ndarray
    up: np.ndarray


@dataclass(frozen=True)
class Source:
    """What is looked at. names, scenes: one splat, or the original and the pruned one. cameras: where it is
    looked at from at first, and drawn as frusta; may be empty. dataset: their photographs. nested: the rows
    of the last scene are in the order of a nested result."""

    names: tuple[str, ...]
    scenes: tuple[Scene, ...]
    cameras: list[Camera]
    dataset: Dataset | None = None
    nested: bool = False
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def middle(self) -> np.ndarray:
        """(3,) float64, the median Gaussian."""
        means = self.scenes[0].means
        return np.median(means[:: max(1, len(means) // 10_000)], axis=0).astype(np.float64)

    @cached_property
    def unit(self) -> float:
        """Camera.unit of those that look at it."""
        return self.cameras[0].unit if self.cameras else unit_around(self.scenes[0])

    def columns(self) -> dict[str, str]:
        """Of COLUMNS, those that every scene has."""
        there = lambda name: all(name in scene.attributes for scene in self.scenes)
        return {label: name for label, name in COLUMNS.items() if there(name)}

    def up(self) -> np.ndarray:
        """(3,): the direction up in the world, as the cameras say."""
        up = up_direction(np.array([camera.viewmat[:3, :3] for camera in self.cameras]))
        return UP if up is None else up

    def start(self) -> View:
        """The first view: that of the first camera, if there is one."""
        if self.cameras:
            return self.view_of(self.cameras[0])
        middle = self.middle()
        reach = np.percentile(np.linalg.norm(self.scenes[0].means - middle, axis=1), 80)
        return View(FOV, middle + max(reach, NEAREST * self.unit) * START, middle, UP)

    def view_of(self, camera: Camera) -> View:
        """The view of a camera. The point in its middle is as far away as the median Gaussian."""
        ahead = camera.viewmat[2, :3]
        distance = max(NEAREST * self.unit, ahead @ (self.middle() - camera.position))
        return View(
            fov_of(camera), camera.position, camera.position + distance * ahead, -camera.viewmat[1, :3]
        )


def fov_of(camera: Camera) -> float:
    """The vertical field of view, in radians."""
    return 2 * math.atan(camera.height / 2 / camera.K[1, 1])
