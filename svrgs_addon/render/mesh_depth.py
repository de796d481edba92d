"""Depth and colour of opaque triangles as a camera sees them: a z-buffer in NumPy.

The triangles of meshes become a depth per pixel. The rasterizer uses it as depth limit: a pixel blends only Gaussians whose centre
is in front of the mesh (composite.py).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Camera

NEAR = 1e-3  # perspective: parts of triangles with z below this share of the z of the farthest corner are clipped
SHADE = 0.35  # brightness of a triangle that is seen edge-on; a triangle that faces the camera has 1
PAIRS_PER_BATCH = 1 << 20  # (triangle, row) or (triangle, pixel) pairs in memory at a time


@dataclass(frozen=True)
class Triangles:
    """M opaque triangles."""

    corners: np.ndarray  # (M, 3, 3) float: triangle, corner, coordinate; world of the camera
    colors: np.ndarray  # (M, 3) display sRGB in 0..1


@dataclass(frozen=True)
class Surface:
    """Triangles as a camera sees them."""

    depth: np.ndarray  # (H, W) float32, camera z; infinite where there is no triangle
    rgb: np.ndarray  # (H, W, 3) float32 display sRGB; 0 where there is no triangle


def surface(triangles: Triangles, camera: Camera) -> Surface:
    """Rasterises the nearest triangle at each pixel centre, with flat shading and light along the camera's axis."""
    corners = triangles.corners.astype(np.float64) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    shaded = triangles.colors * _light(corners)[:, None]
    corners, source = _clipped(corners, 0.0 if camera.orthographic else NEAR)
    depth = np.full(camera.height * camera.width, np.inf, np.float32)
    rgb = np.zeros((len(depth), 3), np.float32)
    x, y = np.moveaxis(camera.pixels(corners), -1, 0)
    planes = _planes(x, y, _screen_linear(corners[..., 2], camera))
    for triangle, row, left, right in _spans(x, y, camera.width, camera.height):
        for span, column in _ranges(left, right):
            owner = triangle[span]
            a, b, c = planes[owner].T
            z = _screen_linear(a * (column + 0.5) + b * (row[span] + 0.5) + c, camera).astype(np.float32)
            pixel = row[span] * camera.width + column
            np.minimum.at(depth, pixel, z)
            won = z == depth[pixel]
            rgb[pixel[won]] = shaded[source[owner[won]]]
    return Surface(depth.reshape(camera.height, camera.width), rgb.reshape(camera.height, camera.width, 3))


def _screen_linear(z: np.ndarray, camera: Camera) -> np.ndarray:
    """Converts camera z to the quantity that is linear in pixel coordinates on a plane, and back: 1 / z in perspective, else z."""
    return z if camera.orthographic else 1 / z


def _light(corners: np.ndarray) -> np.ndarray:
    """Brightness (M,) of triangles (M, 3, 3) in the camera frame, the same from both sides: SHADE + (1 - SHADE) |n_z|.

    n is the unit normal, so all triangles of a plane have the same brightness.
    """
    normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    with np.errstate(divide="ignore", invalid="ignore"):
        facing = np.nan_to_num(np.abs(normal[:, 2]) / np.linalg.norm(normal, axis=1))
    return SHADE + (1 - SHADE) * facing


def _clipped(corners: np.ndarray, share: float) -> tuple[np.ndarray, np.ndarray]:
    """Clips triangles (M, 3, 3) in the camera frame at z = share * (z of the farthest corner).

    Returns the parts behind this plane as triangles (P, 3, 3), and the index of the triangle that each is a part of, (P,).
    Triangles that are not finite are left out.
    """
    finite = np.isfinite(corners).all(axis=(1, 2))
    near = share * corners[finite, :, 2].max(initial=0)
    front = (corners[..., 2] > near) & finite[:, None]
    count = front.sum(axis=1)
    whole, one, two = (np.flatnonzero(count == n) for n in (3, 1, 2))
    # corner 0 is now the only corner on its side of the plane
    single, pair = (_rotated_corners(corners[rows], alone) for rows, alone in ((one, front[one]), (two, ~front[two])))
    s01, s02 = (_at_depth(single[:, 0], single[:, k], near) for k in (1, 2))
    p01, p02 = (_at_depth(pair[:, 0], pair[:, k], near) for k in (1, 2))
    parts = (
        corners[whole], np.stack([single[:, 0], s01, s02], 1),
        np.stack([p01, pair[:, 1], pair[:, 2]], 1), np.stack([p01, pair[:, 2], p02], 1),
    )  # fmt: skip
    return np.concatenate(parts), np.concatenate([whole, one, two, two])


def _rotated_corners(corners: np.ndarray, first: np.ndarray) -> np.ndarray:
    """Triangles (M, 3, 3) that begin with the corner that `first` (M, 3) bool marks, with the same orientation."""
    order = (first.argmax(axis=1)[:, None] + np.arange(3)) % 3
    return corners[np.arange(len(corners))[:, None], order]


def _at_depth(a: np.ndarray, b: np.ndarray, z: float) -> np.ndarray:
    """The points (M, 3) on the lines from a to b (M, 3) that have this camera z."""
    t = (z - a[:, 2:]) / (b[:, 2:] - a[:, 2:])
    return a + t * (b - a)


def _planes(x: np.ndarray, y: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Coefficients a, b, c (M, 3) with a x + b y + c = value at the corners of each triangle. All arguments are (M, 3)."""
    x1, y1, v1 = (q[:, 1] - q[:, 0] for q in (x, y, values))
    x2, y2, v2 = (q[:, 2] - q[:, 0] for q in (x, y, values))
    area = x1 * y2 - x2 * y1
    area[area == 0] = np.inf  # such a triangle covers no pixel
    a, b = (v1 * y2 - v2 * y1) / area, (x1 * v2 - x2 * v1) / area
    return np.stack([a, b, values[:, 0] - a * x[:, 0] - b * y[:, 0]], axis=1)


def _spans(x: np.ndarray, y: np.ndarray, width: int, height: int):
    """Yields arrays (triangle, row, first column, end column) of the pixel centres that the triangles cover, row by row."""
    first, end = (np.ceil(np.clip(edge, 0, height) - 0.5).astype(np.int64) for edge in (y.min(axis=1), y.max(axis=1)))
    for triangle, row in _ranges(first, end):
        middle, left, right = row + 0.5, np.full(len(row), np.inf), np.full(len(row), -np.inf)
        for k in range(3):
            xs, ys, xe, ye = x[triangle, k], y[triangle, k], x[triangle, k - 1], y[triangle, k - 1]
            down = ys > ye  # so adjacent triangles round their common edge in the same way
            xs, ys, xe, ye = np.where(down, xe, xs), np.where(down, ye, ys), np.where(down, xs, xe), np.where(down, ys, ye)
            crosses = (ys <= middle) != (ye <= middle)
            with np.errstate(divide="ignore", invalid="ignore"):
                at = xs + (middle - ys) / (ye - ys) * (xe - xs)
            left, right = np.where(crosses, np.minimum(left, at), left), np.where(crosses, np.maximum(right, at), right)
        left, right = (np.ceil(np.clip(side, 0, width) - 0.5).astype(np.int64) for side in (left, right))
        some = right > left
        yield triangle[some], row[some], left[some], right[some]


def _ranges(first: np.ndarray, end: np.ndarray):
    """Yields arrays (index, value): all integers in [first[i], end[i]) with their index i, about PAIRS_PER_BATCH at a time."""
    lengths = np.maximum(end - first, 0)
    totals = np.cumsum(lengths)
    start = 0
    while start < len(lengths):
        before = totals[start - 1] if start else 0
        stop = max(start + 1, int(np.searchsorted(totals, before + PAIRS_PER_BATCH, side="right")))
        part = lengths[start:stop]
        index = np.repeat(np.arange(start, stop), part)
        offset = np.arange(len(index)) - np.repeat(totals[start:stop] - part - before, part)
        yield index, first[index] + offset
        start = stop
