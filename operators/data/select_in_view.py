"""The Gaussians of a splat inside an outline that was drawn in a viewport."""

from __future__ import annotations

import math
from dataclasses import dataclass

import bpy
import numpy as np
from mathutils import Matrix

from ...svrgs_addon.prune.selection.outline import brush, centres_in, polygon, shown_in
from ...svrgs_addon.scene.gaussians import Scene
from . import visible_splats

CIRCLE = 48  # corners of a drawn circle

Points = list[tuple[float, float]]


@dataclass(frozen=True)
class Outline:
    """What was drawn: shape BOX, LASSO or BRUSH, the path of the mouse in pixels of the region, y up, and the
    radius of the brush."""

    shape: str
    path: Points
    radius: float

    def pixels(self, width: int, height: int) -> np.ndarray:
        """(H, W) bool, rows from the top: what is inside."""
        path = np.array(self.path, np.float64) * (1, -1) + (0, height)
        if self.shape == "BRUSH":
            return brush(path, self.radius, width, height)
        return polygon(_corners(path) if self.shape == "BOX" else path, width, height)

    def lines(self, mouse: tuple[float, float]) -> list[Points]:
        """What to draw, y up. mouse: where it is now."""
        if self.shape == "BRUSH":
            turns = (2 * math.pi * k / CIRCLE for k in range(CIRCLE + 1))
            circle = [
                (mouse[0] + self.radius * math.cos(a), mouse[1] + self.radius * math.sin(a)) for a in turns
            ]
            return [circle, self.path]
        points = _corners(np.array([self.path[0], mouse])).tolist() if self.shape == "BOX" else self.path
        return [[*map(tuple, points), tuple(points[0])]]


def _corners(path: np.ndarray) -> np.ndarray:
    (x0, y0), (x1, y1) = path[0], path[-1]
    return np.array([(x0, y0), (x1, y0), (x1, y1), (x0, y1)])


def gaussians_in(
    scene: Scene,
    matrix: Matrix,
    region: bpy.types.Region,
    view: bpy.types.RegionView3D,
    outline: Outline,
    through: bool,
) -> np.ndarray:
    """(N,) bool: the Gaussians of a scene, placed in Blender's world by a matrix, whose centres are inside an
    outline in a viewport, and which its pixels show; through: also those behind others. Raises SplatError."""
    camera = visible_splats.region_camera(region, view)
    inside = outline.pixels(camera.width, camera.height)
    if through:
        return centres_in(scene.means, camera, inside, np.array(matrix))
    placed = visible_splats.placed([(scene, matrix)])
    mask = shown_in(placed.scene, placed.seen_by(camera), inside)
    mask[mask] = centres_in(scene.means[mask], camera, inside, np.array(matrix))
    return mask
