"""Equirectangular panoramas, put together from many perspective views.

A Gaussian is projected with the Jacobian at its centre, and Gaussians are sorted by z. So two views show the
same direction a little differently, the more so the farther it is from their axes: six cube faces have seams,
and are wrong beside them. Here, views stand CELL apart in longitude and latitude. The weight of a view falls
linearly from 1 at its middle to 0 at the middles of its neighbours. So no view is used at its border, and
between two pixels nothing jumps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from ..native.pictures import add_view
from ..scene.camera import Camera
from .composite import FAR, Composite

BANDS = 9  # of views between the poles
CELL = np.pi / BANDS  # radians between the middles of neighbouring views
MARGIN = 2  # pixels around what is used of a view
RGB, COVERAGE, HOLES, DEPTH, REST = slice(0, 3), 3, 4, 5, 6  # in the last axis of layers


@dataclass(frozen=True)
class Panorama:
    """Pose and limits of an equirectangular picture.

    Columns are longitudes from left to right, rows latitudes from the top: the pixel (x, y) sees the
    direction (sin lon cos lat, -sin lat, cos lon cos lat) of the camera frame (x right, y down, z forward).
    """

    viewmat: np.ndarray  # (4, 4) float64, world to camera
    width: int
    height: int
    longitude: tuple[float, float] = (-np.pi, np.pi)  # radians, at the left and at the right border
    # radians, at the lower and at the upper border; within the poles
    latitude: tuple[float, float] = (-np.pi / 2, np.pi / 2)

    @property
    def longitudes(self) -> np.ndarray:
        """(W,) of the centres of columns."""
        first, last = self.longitude
        return first + (np.arange(self.width) + 0.5) / self.width * (last - first)

    @property
    def latitudes(self) -> np.ndarray:
        """(H,) of the centres of rows."""
        last, first = self.latitude
        return first + (np.arange(self.height) + 0.5) / self.height * (last - first)

    @property
    def focal(self) -> float:
        """Pixels per radian, the larger of both axes: the focal length of views with such pixels."""
        spans = (abs(last - first) for first, last in (self.longitude, self.latitude))
        return max(side / span for side, span in zip((self.width, self.height), spans, strict=True))


@dataclass(frozen=True)
class Patch:
    """A perspective view and its share in each pixel: row times column weight; their sum is 1."""

    camera: Camera
    turn: np.ndarray  # (3, 3) from the panorama's frame to that of the view
    row_weights: np.ndarray  # (H,)
    column_weights: np.ndarray  # (W,)


def patches(panorama: Panorama) -> Iterator[Patch]:
    """All views with a share in the panorama, from the lowest latitude to the highest."""
    for band in range(BANDS + 1):
        latitude = (band - BANDS / 2) * CELL
        row_weights = np.maximum(0, 1 - np.abs(panorama.latitudes - latitude) / CELL)
        count = int(np.ceil(2 * np.pi * np.cos(max(abs(latitude) - CELL / 2, 0)) / CELL))
        if band in (0, BANDS):
            count = 1
        for number in range(count):
            longitude = -np.pi + 2 * np.pi * (number + 0.5) / count
            apart = np.abs((panorama.longitudes - longitude + np.pi) % (2 * np.pi) - np.pi)
            column_weights = np.ones(panorama.width)
            if count > 1:
                column_weights = np.maximum(0, 1 - apart * count / (2 * np.pi))
            if row_weights.any() and column_weights.any():
                turn = _facing(latitude, longitude)
                camera = _view(panorama, turn, row_weights > 0, column_weights > 0)
                yield Patch(camera, turn, row_weights, column_weights)


def directions(latitudes: np.ndarray, longitudes: np.ndarray) -> np.ndarray:
    """Unit directions (..., 3) in the camera frame, of latitudes and longitudes that broadcast."""
    latitudes, longitudes = np.broadcast_arrays(latitudes, longitudes)
    level = np.cos(latitudes)
    return np.stack([np.sin(longitudes) * level, -np.sin(latitudes), np.cos(longitudes) * level], axis=-1)


def _facing(latitude: float, longitude: float) -> np.ndarray:
    """Rotation (3, 3) from the panorama's frame to that of a view of this direction with level rows."""
    right = np.array([np.cos(longitude), 0, -np.sin(longitude)])
    forward = directions(np.array(latitude), np.array(longitude))
    return np.stack([right, np.cross(forward, right), forward])


def _view(panorama: Panorama, turn: np.ndarray, rows: np.ndarray, columns: np.ndarray) -> Camera:
    """The camera of a view, just large enough for rows (H,) bool and columns (W,) bool of the panorama."""
    latitudes, longitudes = panorama.latitudes[rows], panorama.longitudes[columns]
    border = [
        directions(latitudes[[0, -1]][:, None], longitudes).reshape(-1, 3),
        directions(latitudes[:, None], longitudes[[0, -1]]).reshape(-1, 3),
    ]
    rays = np.concatenate(border) @ turn.T
    plane = panorama.focal * rays[:, :2] / rays[:, 2:]
    low, high = np.floor(plane.min(axis=0)) - MARGIN, np.ceil(plane.max(axis=0)) + MARGIN
    viewmat = np.eye(4)
    viewmat[:3] = turn @ panorama.viewmat[:3]
    K = np.array([[panorama.focal, 0, -low[0]], [0, panorama.focal, -low[1]], [0, 0, 1]])
    width, height = (int(side) for side in high - low)
    return Camera(viewmat, K, width, height)


def composite_panorama(draw: Callable[[Camera], Composite], panorama: Panorama) -> Composite:
    """A panorama's picture; draw() renders a perspective one. Depths are distances, as in Cycles."""
    sums, directions = None, (panorama.latitudes, panorama.longitudes)
    for patch in patches(panorama):
        picture = draw(patch.camera)
        layers = _layers(picture)
        if sums is None:
            sums = np.zeros((panorama.height, panorama.width, layers.shape[2]), np.float32)
        weights = patch.row_weights, patch.column_weights
        add_view(layers, patch.turn, patch.camera.K, DEPTH, sums, *directions, *weights)
    assert sums is not None
    return _picture(sums, picture)


def composite_view(draw: Callable[[Camera], Composite], view: Camera | Panorama) -> Composite:
    """The picture of a view. draw: renders a perspective or orthographic view."""
    return composite_panorama(draw, view) if isinstance(view, Panorama) else draw(view)


def _layers(picture: Composite) -> np.ndarray:
    """All images of a picture side by side, (H, W, L) float32; the depth is multiplied with the coverage."""
    depth = np.where(picture.coverage > 0, picture.depth, 0) * picture.coverage
    rest = [image for name, image in picture.images.items() if name != "depth"]
    flat = np.stack([picture.coverage, picture.holes, depth, *rest], axis=2)
    behind = [] if picture.behind is None else [picture.behind]
    return np.concatenate([picture.rgb, flat, *behind], axis=2, dtype=np.float32)


def _picture(layers: np.ndarray, like: Composite) -> Composite:
    """The inverse of _layers, values in their ranges, which cubic interpolation leaves. like: its images."""
    coverage, holes = (layers[..., k].clip(0, 1) for k in (COVERAGE, HOLES))
    depth = np.divide(layers[..., DEPTH], coverage, out=np.full_like(coverage, FAR), where=coverage > 0)
    names = [name for name in like.images if name != "depth"]
    images = {name: layers[..., REST + k].clip(0, None) for k, name in enumerate(names)} | {"depth": depth}
    behind = None
    if like.behind is not None:
        behind = layers[..., REST + len(names) :].clip(0, (np.inf, np.inf, np.inf, 1))
    return replace(
        like, rgb=layers[..., RGB].copy(), coverage=coverage, holes=holes, images=images, behind=behind
    )
