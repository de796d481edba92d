"""Where the mass of a scene is, so that a view shows it and not its outliers."""

from __future__ import annotations

import itertools
import math

import numpy as np

from .camera import Camera

MIDDLE = 0.2, 0.8  # quantiles along each axis; outliers and a background all around are outside
# of the box between them: it then holds a body of even density as a whole
WIDER = 1 / (MIDDLE[1] - MIDDLE[0])
NEARLY_ALL = 0.005, 0.995  # quantiles along each axis between which a body lies with its limbs
LIMB = 2.5  # half sides of the box around the mass, from its middle, up to which a limb belongs to the body
SAMPLES = 200_000  # points that count, at most, evenly spaced in the list
# clipping distances over the distance of the view; far over near
CLIP_NEAR, CLIP_FAR, CLIP_RATIO = 0.01, 100.0, 1e6


def robust_box(points: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray | None:
    """Lower and upper corner (2, 3) float64 of a box around the mass of the points: that between the
    quantiles MIDDLE, WIDER times as wide.

    points: (P, 3). weights: (P,) of at least 0, such as opacities; None: equal ones. Points that are not
    finite are left out. None if no point has a weight.
    """
    points, weights = _usable(points, weights)
    if not len(points):
        return None
    low, high = np.array([weighted_quantiles(axis, weights, MIDDLE) for axis in points.T]).T
    middle, reach = (low + high) / 2, WIDER * (high - low) / 2
    return np.array([middle - reach, middle + reach])


def body_box(points: np.ndarray, weights: np.ndarray | None = None) -> np.ndarray | None:
    """As robust_box(), but also around the quantiles NEARLY_ALL of what lies no farther than LIMB: a head or
    a hand is then inside, floaters and a sky are not."""
    box = robust_box(points, weights)
    if box is None:
        return None
    points, weights = _usable(points, weights)
    near = (np.abs(points - box.mean(axis=0)) <= LIMB * np.ptp(box, axis=0) / 2).all(axis=1)
    outer = np.array([weighted_quantiles(axis, weights[near], NEARLY_ALL) for axis in points[near].T]).T
    return np.array([np.minimum(box[0], outer[0]), np.maximum(box[1], outer[1])])


def median_depth(camera: Camera, points: np.ndarray, weights: np.ndarray | None = None) -> float | None:
    """The weighted median of the distances, along the axis of the camera, of the points (P, 3), world, that
    it shows; None if it shows none. weights: as in robust_box."""
    points, weights = _usable(points, weights)
    local = camera.local(points)
    shown = camera.shows(local)
    return float(weighted_quantiles(local[shown, 2], weights[shown], 0.5)) if shown.any() else None


def corners(box: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """The corners (8, 3) float64 of a box (2, 3), moved by the affine matrix (4, 4)."""
    matrix = np.asarray(matrix, np.float64)
    places = np.array(list(itertools.product(*np.asarray(box, np.float64).T)))
    return places @ matrix[:3, :3].T + matrix[:3, 3]


def sphere_around(points: np.ndarray) -> tuple[np.ndarray, float]:
    """Centre (3,) of the box around the points (P, 3), and the radius of the sphere around it with all."""
    centre = (points.min(axis=0) + points.max(axis=0)) / 2
    return centre, float(np.linalg.norm(points - centre, axis=1).max())


def viewing_distance(radius: float, lens: float, width: int, height: int, sensor: float) -> float:
    """The distance from the centre of a sphere at which it just fits into the picture.

    lens, sensor: millimetres; the sensor is as long as the longer side of the picture. width, height: of the
    picture, in pixels.
    """
    tangent = sensor / 2 / lens * min(width, height) / max(width, height)
    return radius / math.sin(math.atan(tangent))


def clipping(distance: float, start: float, end: float) -> tuple[float, float]:
    """Near and far clipping distances that suit a view from this distance: `start` and `end`, widened where
    that is needed. Their ratio stays below CLIP_RATIO, for the precision of the depth buffer."""
    end = max(end, CLIP_FAR * distance)
    return max(min(start, CLIP_NEAR * distance), end / CLIP_RATIO), end


def _usable(points: np.ndarray, weights: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """At most SAMPLES of the points that are finite and have a weight, (P', 3) float64, and their weights."""
    step = max(1, -(-len(points) // SAMPLES))
    points = np.asarray(points[::step], np.float64)
    weights = np.ones(len(points)) if weights is None else np.asarray(weights[::step], np.float64)
    good = np.isfinite(points).all(axis=1) & (weights > 0)
    return points[good], weights[good]


def weighted_quantiles(
    values: np.ndarray, weights: np.ndarray, shares: float | tuple[float, ...]
) -> np.ndarray:
    """The values (P,), P > 0, below which these shares of the weights (P,) lie, shaped as `shares`."""
    order = np.argsort(values, kind="stable")
    total = np.cumsum(weights[order])
    return np.interp(shares, (total - weights[order] / 2) / total[-1], values[order])
