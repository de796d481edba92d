"""Which way is up in a photographed scene, and the turn that brings it upright.

Photographers hold cameras level: the right-hand side of most photographs points along the horizon, whether
they look down or not. So up is the direction at right angles to the right-hand sides. Where all of them are
nearly parallel, as in a walk along a street, that leaves a choice, and the mean of the upper sides of the
photographs decides.
"""

from __future__ import annotations

import numpy as np

MIN_VIEWS = 3
# a photograph counts as level if its right-hand side is no further above or below the horizon
LEVEL = np.sin(np.radians(20))
CONSENSUS = 2 / 3  # share of the views that must be level and not upside down
# right-hand sides span a plane if their second smallest variance is SPREAD times the smallest, at least NOISE
SPREAD, NOISE = 8.0, 1e-4
# a mean upper side that agrees less with the result does not decide which of its two directions is up
CLEAR = 0.2
ROUNDS = 10


def up_direction(rotations: np.ndarray) -> np.ndarray | None:
    """The unit vector (3,) that points up in the world, or None if the views do not agree on one.

    rotations: (V, 3, 3), world to camera, camera frame of COLMAP. A third of the views may be rolled, as
    photographs in portrait format.
    """
    rotations = np.asarray(rotations, np.float64).reshape(-1, 3, 3)
    if len(rotations) < MIN_VIEWS:
        return None
    right, top, forward = rotations[:, 0], -rotations[:, 1], rotations[:, 2]
    # the second for views straight down, whose upper sides cancel out
    for guess in (_median_direction(top), _fitted(right, top, forward)):
        up = _refined(guess, right, top, forward)
        if _level(right, top, up).mean() >= CONSENSUS:
            return up
    return None


def levelled(matrix: np.ndarray, up: np.ndarray) -> np.ndarray:
    """The affine matrix (4, 4), turned the shortest way to map `up` (3,) to +z; scale and origin stay."""
    turned = np.array(matrix, np.float64)
    now = turned[:3, :3] @ up
    turned[:3, :3] = _shortest_turn(now / np.linalg.norm(now)) @ turned[:3, :3]
    return turned


def tilt(matrix: np.ndarray, up: np.ndarray) -> float:
    """The angle in degrees between +z and the direction to which the affine matrix (4, 4) maps `up` (3,)."""
    now = np.asarray(matrix, np.float64)[:3, :3] @ up
    return float(np.degrees(np.arctan2(np.linalg.norm(now[:2]), now[2])))


def _refined(up: np.ndarray, right: np.ndarray, top: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """The direction (3,) that fits the views which are level by it, from a first guess."""
    for _ in range(ROUNDS):
        level = _level(right, top, up)
        if not level.any():
            break
        up = _fitted(right[level], top[level], forward[level])
    return up


def _level(right: np.ndarray, top: np.ndarray, up: np.ndarray) -> np.ndarray:
    """(V,) bool: the views that are neither rolled nor upside down."""
    return (np.abs(right @ up) < LEVEL) & (top @ up > -LEVEL)


def _fitted(right: np.ndarray, top: np.ndarray, forward: np.ndarray) -> np.ndarray:
    """The unit vector that is most at right angles to the right-hand sides (V, 3) of the views."""
    variances, axes = np.linalg.eigh(right.T @ right / len(right))
    mean_top = top.mean(axis=0)
    if variances[1] < SPREAD * max(variances[0], NOISE):
        mean_top -= axes[:, 2] * (axes[:, 2] @ mean_top)
        return mean_top / max(float(np.linalg.norm(mean_top)), 1e-300)
    normal = axes[:, 0]
    agreement = mean_top @ normal
    if abs(agreement) < CLEAR:  # the views look straight down, as those of a drone: up is behind the cameras
        agreement = -forward.mean(axis=0) @ normal
    return normal if agreement > 0 else -normal


def _median_direction(directions: np.ndarray) -> np.ndarray:
    """The direction (3,) with the smallest sum of distances to unit vectors (V, 3)."""
    middle = directions.mean(axis=0)
    for _ in range(ROUNDS):
        weights = 1 / np.maximum(np.linalg.norm(directions - middle, axis=1), 1e-6)
        middle = weights @ directions / weights.sum()
    return middle / max(float(np.linalg.norm(middle)), 1e-300)


def _shortest_turn(start: np.ndarray) -> np.ndarray:
    """The smallest rotation (3, 3) that takes the unit vector `start` to +z; from -z, half a turn about x."""
    x, y, z = start
    if z < -1 + 1e-12:
        return np.diag([1.0, -1.0, -1.0])
    return np.array(
        [[1 - x * x / (1 + z), -x * y / (1 + z), -x], [-x * y / (1 + z), 1 - y * y / (1 + z), -y], [x, y, z]]
    )
