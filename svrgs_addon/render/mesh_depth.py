"""Opaque triangles through a camera: how far away the nearest one is at each pixel, and its colour. A z-buffer in NumPy."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Camera

NEAR = 1e-3  # of the farthest corner: nearer parts of triangles are cut off in perspective
SHADE = 0.35  # light on a triangle seen edge-on; 1 on one that faces the camera
AT_ONCE = 1 << 20  # (triangle, row) or (triangle, pixel) pairs held in memory


@dataclass(frozen=True)
class Triangles:
    """Opaque geometry."""

    corners: np.ndarray  # (M, 3, 3) float: triangle, corner, coordinate; in the camera's world
    colors: np.ndarray  # (M, 3) display sRGB


@dataclass(frozen=True)
class Surface:
    """What a camera sees of triangles."""

    depth: np.ndarray  # (H, W) float32 along the camera's z axis; infinite where there is nothing
    rgb: np.ndarray  # (H, W, 3) float32 display sRGB; 0 where there is nothing


def surface(triangles: Triangles, camera: Camera) -> Surface:
    """The nearest triangle at every pixel centre, flat, lit along the camera's axis."""
    corners = triangles.corners.astype(np.float64) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    shaded = triangles.colors * _light(corners)[:, None]
    corners, source = _clipped(corners, 0.0 if camera.orthographic else NEAR)
    depth = np.full(camera.height * camera.width, np.inf, np.float32)
    rgb = np.zeros((len(depth), 3), np.float32)
    x, y = np.moveaxis(camera.pixels(corners), -1, 0)
    planes = _planes(x, y, _flat(corners[..., 2], camera))
    for triangle, row, left, right in _spans(x, y, camera.width, camera.height):
        for span, column in _expanded(left, right):
            owner = triangle[span]
            a, b, c = planes[owner].T
            z = _flat(a * (column + 0.5) + b * (row[span] + 0.5) + c, camera).astype(np.float32)
            pixel = row[span] * camera.width + column
            np.minimum.at(depth, pixel, z)
            won = z == depth[pixel]
            rgb[pixel[won]] = shaded[source[owner[won]]]
    return Surface(depth.reshape(camera.height, camera.width), rgb.reshape(camera.height, camera.width, 3))


def _flat(z: np.ndarray, camera: Camera) -> np.ndarray:
    """Depths as what changes evenly across the picture of a plane, and back: 1 / z in perspective."""
    return z if camera.orthographic else 1 / z


def _light(corners: np.ndarray) -> np.ndarray:
    """(M,) brightness of triangles (M, 3, 3) in the camera's frame, from either side; that of a plane is one."""
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = np.nan_to_num(np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1))
    return SHADE + (1 - SHADE) * facing


def _clipped(corners: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """The parts of triangles (M, 3, 3) farther before the camera than this share of the farthest corner, as triangles, and the one each
    is part of."""
    finite = np.isfinite(corners).all(axis=(1, 2))
    near = share * corners[finite, :, 2].max(initial=0)
    front = (corners[..., 2] > near) & finite[:, None]
    count = front.sum(axis=1)
    whole, one, two = (np.flatnonzero(count == n) for n in (3, 1, 2))
    # turned so that corner 0 is the one that differs from the other two
    single, pair = (_turned(corners[rows], alone) for rows, alone in ((one, front[one]), (two, ~front[two])))
    s01, s02 = (_at_depth(single[:, 0], single[:, k], near) for k in (1, 2))
    p01, p02 = (_at_depth(pair[:, 0], pair[:, k], near) for k in (1, 2))
    parts = (
        corners[whole], np.stack([single[:, 0], s01, s02], 1),
        np.stack([p01, pair[:, 1], pair[:, 2]], 1), np.stack([p01, pair[:, 2], p02], 1),
    )  # fmt: skip
    return np.concatenate(parts), np.concatenate([whole, one, two, two])


def _turned(corners: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Triangles (M, 3, 3) with the corner that `first` (M, 3) marks in front, in the same sense of rotation."""
    order = (first.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return corners[np.arange(len(corners))[:, None], order]


def _at_depth(a: np.ndarray, b: np.ndarray, z: float) -> np.ndarray:
    t = (z - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return a + t * (b - a)


def _planes(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> np.ndarray:
    """(M, 3) a, b, c with a x + b y + c = value at each triangle's corners; all arguments (M, 3)."""
    x1, y1, v1 = (q[:, 1] - q[:, 0] for q in (x, y, values))
    x2, y2, v2 = (q[:, 2] - q[:, 0] for q in (x, y, values))
    area = x1 * y2 - x2 * y1
    area[area == 0] = np.inf  # covers no pixel
    a, b = (v1 * y2 - v2 * y1) / area, (x1 * v2 - x2 * v1) / area
    return np.stack([a, b, values[:, 0] - a * x[:, 0] - b * y[:, 0]], axis=1)


def _spans(x: np.ndarray, y: np.ndarray, width: int, height: int):
    """Yields (triangle, row, first column, end column) arrays: the pixel centres each triangle covers, row by row."""
    first, end = (np.ceil(np.clip(edge, 0, height) - 0.5).astype(np.int64) for edge in (y.min(axis=1), y.max(axis=1)))
    for triangle, row in _expanded(first, end):
        middle, left, right = row + 0.5, np.full(len(row), np.inf), np.full(len(row), -np.inf)
        for k in range(3):
            xs, ys, xe, ye = x[triangle, k], y[triangle, k], x[triangle, k - 1], y[triangle, k - 1]
            down = ys > ye  # neighbours must round their common edge alike
            xs, ys, xe, ye = np.where(down, xe, xs), np.where(down, ye, ys), np.where(down, xs, xe), np.where(down, ys, ye)
            crosses = (ys <= middle) != (ye <= middle)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = xs + (middle - ys) / (ye - ys) * (xe - xs)
            left, right = np.where(crosses, np.minimum(left, at), left), np.where(crosses, np.maximum(right, at), right)
        left, right = (np.ceil(np.clip(side, 0, width) - 0.5).astype(np.int64) for side in (left, right))
        some = right > left
        yield triangle[some], row[some], left[some], right[some]


def _expanded(first: np.ndarray, end: np.ndarray):
    """Yields (index, value) arrays: every integer value in [first[i], end[i]) with its index i, about AT_ONCE at a time."""
    lengths = np.maximum(end - first, 0)
    totals = np.cumsum(lengths)
    start = 0
    while start < len(lengths):
        before = totals[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(totals, before + AT_ONCE, side="right")))
        part = lengths[start:stop]
        index = np.repeat(np.arange(start, stop), part)
        offset = np.arange(len(index)) - np.repeat(totals[start:stop] - part - before, part)
        yield index, first[index] + offset
        start = stop
