"""Where the mass of a scene is, so that a view shows it and not its outliers."""

from __future__ import annotations

import itertools
import math

import numpy as np

INSIDE = 0.02, 0.98  # quantiles along each axis
SAMPLES = 200_000  # points that are looked at, at most, evenly spaced in the list
CLIP_NEAR, CLIP_FAR, CLIP_RATIO = 0.01, 100.0, 1e6  # clipping distances over the distance of the view; far over near


def robust_box(points: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray | None:
    """Lower and upper corner (2, 3) float64 of the box between the quantiles INSIDE of the points along each axis.

    points: (P, 3). weights: (P,) of at least 0, such as opacities; None: equal ones. Points that are not finite are left out. None if no
    point has a weight.
    """
    step = max(1, -(-len(points) // SAMPLES))
    points = np.asarray(points[::step], np.float64)
    weights = np.ones(len(points)) if weights is None else np.asarray(weights[::step], np.float64)
    good = np.isfinite(points).all(axis=1) & (weights > 0)
    points, weights = points[good], weights[good]
    if not len(points):
        return None
    box = np.empty((2, 3))
    for axis in range(3):
        order = np.argsort(points[:, axis], kind="stable")
        share = np.cumsum(weights[order])
        share = (share - weights[order] / 2) / share[-1]
        box[:, axis] = np.interp(INSIDE, share, points[order, axis])
    return box


def corners(box: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The corners (8, 3) float64 of a box (2, 3), moved by the affine matrix (4, 4)."""
    matrix = np.asarray(matrix, np.float64)
    places = np.array(list(itertools.product(*np.asarray(box, np.float64).T)))
    return places @ matrix[:3, :3].T + matrix[:3, 3]


def sphere_around(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) of the box around the points (P, 3), and the radius of the sphere around it that holds them all."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def viewing_distance(radius: float, lens: float, width: int, height: int, sensor: float) -> float:
    """The distance from the centre of a sphere at which it just fits into the picture.

    lens, sensor: millimetres; the sensor is as long as the longer side of the picture. width, height: of the picture, in pixels.
    """
    tangent = sensor / 2 / lens * min(width, height) / max(width, height)
    return radius / math.sin(math.atan(tangent))


def clipping(distance: float, start: float, end: float) -> tuple[float, float]:
    """Near and far clipping distances that show a sphere at this distance: `start` and `end`, widened where that is needed.

    Their ratio stays below CLIP_RATIO, for the precision of the depth buffer.
    """
    end = max(end, CLIP_FAR * distance)
    return max(min(start, CLIP_NEAR * distance), end / CLIP_RATIO), end
