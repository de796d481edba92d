"""The Gaussians of a splat inside an outline that was drawn in a viewport."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from mathutils import Matrix

from ...svrgs_addon.prune.selection.outline import RenderedView, brush, centres_in, polygon
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.gaussians import Scene
from . import visible_splats

CIRCLE = 48  # corners of a drawn circle
VIEW = ("viewmat", "K", "width", "height", "orthographic")  # of a camera

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


class ViewportView:
    """A scene, placed in Blender's world by a matrix, as a viewport shows it."""

    def __init__(self, scene: Scene, matrix: Matrix, camera: Camera):
        self._scene, self._matrix, self._camera = scene, matrix.copy(), camera
        placed = visible_splats.placed([(scene, matrix)])
        self._rendered = RenderedView(placed.scene, placed.seen_by(camera))

    def begin(self):
        """Renders the view in a thread, while an outline is still drawn. gaussians_in() then takes less
        time."""
        self._rendered.begin()

    def shows(self, scene: Scene, matrix: Matrix, camera: Camera) -> bool:
        """Whether it is what ViewportView(scene, matrix, camera) would be."""
        same = (np.array_equal(getattr(camera, name), getattr(self._camera, name)) for name in VIEW)
        return scene is self._scene and matrix == self._matrix and all(same)

    def gaussians_in(self, inside: np.ndarray) -> np.ndarray:
        """(N,) bool: the Gaussians whose centres are in one of the pixels (H, W) bool, and which one of these
        shows. Raises SplatError."""
        mask = self._rendered.shown_in(inside)
        camera = _with_unit(self._camera, self._scene, self._matrix)
        mask[mask] = centres_in(self._scene.means[mask], camera, inside, np.array(self._matrix))
        return mask


def _with_unit(camera: Camera, scene: Scene, matrix: Matrix) -> Camera:
    """The camera, in Blender's world, with the unit that pictures of the scene have, as a length there."""
    placed = visible_splats.PlacedScene(scene, matrix)
    return replace(camera, unit=placed.unit * placed.seen_by(camera).unit)


def gaussians_in(
    scene: Scene,
    matrix: Matrix,
    camera: Camera,
    outline: Outline,
    through: bool,
    begun: ViewportView | None = None,
) -> np.ndarray:
    """(N,) bool: the Gaussians of a scene, placed in Blender's world by a matrix, whose centres are inside an
    outline in the view of a camera, and which its pixels show; through: also those behind others. begun: this
    view, if its rendering has begun. Raises SplatError."""
    inside = outline.pixels(camera.width, camera.height)
    if through:
        return centres_in(scene.means, _with_unit(camera, scene, matrix), inside, np.array(matrix))
    if begun is None or not begun.shows(scene, matrix, camera):
        begun = ViewportView(scene, matrix, camera)
    return begun.gaussians_in(inside)
