"""A perspective or orthographic camera. Camera frame of COLMAP: x right, y down, z forward. Pixel centres are
at k + 0.5."""

from __future__ import annotations

import itertools
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath
from typing import TypeVar

import numpy as np

from ..system.errors import SceneError

View = TypeVar("View")
MAX_PIXELS = 1e9  # of a focal length or principal point
MAX_DISTANCE = 1e15  # of a camera from the world's origin; nothing farther is rendered
EXTENT_MARGIN = 1.1  # as in 3DGS
# extent of a capture as COLMAP scales it; the least that counts as such, and the largest, in usual ones
USUAL_EXTENT, LEAST_EXTENT, LARGEST = 5.0, 2.0, 10.0
MOST_POINTS = 1_000_000  # whose distance is measured


@dataclass(frozen=True)
class Camera:
    """Pose and intrinsics of one view.

    A point (x, y, z) of the camera frame is projected to pixel (fx x / z + cx, fy y / z + cy) by a
    perspective camera, and to (fx x + cx, fy y + cy) by an orthographic one.
    """

    viewmat: np.ndarray  # (4, 4) float64, world to camera
    K: np.ndarray  # (3, 3) float64, pixels; orthographic: fx and fy are pixels per unit of length
    width: int
    height: int
    name: str = ""  # image name, with '/' between folders
    # parallel rays: no division by z; the view direction of all colours is the camera's axis
    orthographic: bool = False
    # (H, ceil(W / 8)) uint8, bits of np.packbits: the pixels that count, from a photograph's mask; None: all
    valid_bits: np.ndarray | None = None
    unit: float = 1.0  # unit_of() its world: no Gaussian is drawn that is nearer than a share of it

    @property
    def valid(self) -> np.ndarray | None:
        """(H, W) uint8, 1 for the pixels that count; nothing is learned from the others. None: all count."""
        if self.valid_bits is None:
            return None
        return np.unpackbits(self.valid_bits, axis=1, count=self.width)

    @property
    def valid_share(self) -> float:
        """The share of the pixels that count."""
        return 1.0 if (valid := self.valid) is None else float(valid.mean())

    def masked(self, valid: np.ndarray | None) -> Camera:
        """The same view, in which the pixels count that are not 0 in valid (H, W); None: all."""
        bits = None if valid is None else np.packbits(np.ascontiguousarray(valid) != 0, axis=1)
        return replace(self, valid_bits=bits)

    @property
    def position(self) -> np.ndarray:
        """Camera centre -Rᵀ t in world coordinates, (3,) float64."""
        R, t = self.viewmat[:3, :3], self.viewmat[:3, 3]
        return -R.T @ t

    @property
    def usable(self) -> bool:
        """Whether pose and intrinsics are finite, not absurdly large, and focal lengths positive."""
        in_range = (np.abs(self.K) < MAX_PIXELS).all() and (np.abs(self.viewmat) < MAX_DISTANCE).all()
        return bool(in_range and self.K[0, 0] > 0 and self.K[1, 1] > 0)

    @property
    def key(self) -> bytes:
        """Bytes that are equal for two cameras with the same pose, intrinsics, image size and kind of
        projection, and the same pixels that count; the name does not matter."""
        numbers = [*self.viewmat.flat, *self.K.flat, self.width, self.height, self.orthographic]
        numbers += [self.unit] if self.unit != 1 else []
        return np.array(numbers, np.float64).tobytes() + (
            b"" if self.valid_bits is None else self.valid_bits.tobytes()
        )

    def local(self, points: np.ndarray) -> np.ndarray:
        """World points (N, 3) in the camera frame, (N, 3) float64."""
        return points @ self.viewmat[:3, :3].T + self.viewmat[:3, 3]

    def shows(self, points: np.ndarray) -> np.ndarray:
        """(N,) bool: whether points (N, 3) of the camera frame are in front of it and in its picture."""
        pixels = self.pixels(points)
        inside = (pixels >= 0).all(axis=1) & (pixels < (self.width, self.height)).all(axis=1)
        return inside & (points[:, 2] > 0)

    def pixels(self, points: np.ndarray) -> np.ndarray:
        """Pixels (..., 2) float64 of points (..., 3) of the camera frame; meaningless where z <= 0."""
        with np.errstate(divide="ignore", invalid="ignore"):
            plane = points[..., :2] if self.orthographic else points[..., :2] / points[..., 2:]
        return plane @ self.K[:2, :2].T + self.K[:2, 2]

    def directions(self, points: np.ndarray) -> np.ndarray:
        """Unit directions (N, 3) from the camera to world points (N, 3), world, in the points' dtype."""
        if self.orthographic:
            return np.broadcast_to(self.viewmat[2, :3].astype(points.dtype), points.shape)
        rays = points - self.position.astype(points.dtype)
        return rays / np.maximum(np.linalg.norm(rays, axis=1, keepdims=True), 1e-12)

    def moved(self, matrix: np.ndarray) -> Camera:
        """The same view in other world coordinates.

        matrix: (4, 4), maps the new world to this camera's world; a rotation, a translation and one uniform
        scale s. Lengths in the new world, depths included, are 1 / s of those in this one; `unit` stays.
        """
        viewmat: np.ndarray = self.viewmat @ np.asarray(matrix, np.float64)
        scale = abs(np.linalg.det(viewmat[:3, :3])) ** (1 / 3)
        viewmat[:3] /= scale
        return replace(
            self, viewmat=viewmat, K=self.K @ np.diag([scale, scale, 1.0]) if self.orthographic else self.K
        )

    def displaced(self, motion: np.ndarray) -> Camera:
        """The same view from another pose. motion: (6,), a rotation vector about the camera centre, radians
        about the camera's axes, and a translation of the centre along them, world units."""
        angle = float(np.linalg.norm(motion[:3]))
        cross = np.cross(motion[:3], np.eye(3))  # cross @ v = v x rotation: of the inverse rotation
        first, second = (math.sin(angle) / angle, (1 - math.cos(angle)) / angle**2) if angle else (1.0, 0.5)
        moved = np.eye(4)
        moved[:3, :3] += first * cross + second * cross @ cross
        moved[:3, 3] = -moved[:3, :3] @ motion[3:]
        return replace(self, viewmat=moved @ self.viewmat)

    def resized(self, width: int, height: int) -> Camera:
        """The same view with another image size in pixels; K is scaled by the ratios of the sides."""
        scale = np.diag([width / self.width, height / self.height, 1.0])
        whole = replace(self, K=scale @ self.K, width=width, height=height, valid_bits=None)
        return whole if (valid := self.valid) is None else whole.masked(resized_valid(valid, width, height))

    def fitted(self, longest: int) -> Camera:
        """The same view with an image whose longer side has at most `longest` pixels."""
        share = min(1.0, longest / max(self.width, self.height))
        return self.resized(max(1, round(share * self.width)), max(1, round(share * self.height)))

    def reducible(self, factor: int) -> int:
        """The factor of reduced(), but 1 if no pixel would count any more."""
        return factor if self.valid_bits is None or self.reduced(factor).valid_share else 1

    def reduced(self, factor: int) -> Camera:
        """The same view at 1 / factor of the size: each pixel covers a block of factor x factor pixels of
        this camera.

        Columns and rows at the end that do not fill a block are left out. The intrinsics are exact: the
        centre k + 0.5 of a new pixel is the centre of its block.
        """
        if factor == 1:
            return self
        width, height, valid = self.width // factor, self.height // factor, self.valid
        K = np.diag([1 / factor, 1 / factor, 1.0]) @ self.K
        whole = replace(self, K=K, width=width, height=height, valid_bits=None)
        if valid is not None:
            valid = resized_valid(valid[: height * factor, : width * factor], width, height)
        return whole.masked(valid)


def extent_of(cameras: Sequence[Camera]) -> float:
    """Scene extent of 3DGS in world units: 1.1 times the largest distance of a camera from their mean
    position."""
    centres = np.array([camera.position for camera in cameras])
    return float(EXTENT_MARGIN * np.linalg.norm(centres - centres.mean(axis=0), axis=1).max())


def unit_of(size: float, usual: float = USUAL_EXTENT, least: float = LEAST_EXTENT) -> float:
    """The length, in world units, that constants of the published methods count as 1: they were chosen in
    worlds as COLMAP scales them. 1 in a world of about that size, else in proportion to the size.

    size: extent_of() the cameras, or another measure; usual, least: its value in such a world, and the least
    that counts as such."""
    return 1.0 if least <= size <= LARGEST * usual or not size > 0 else size / usual


def in_their_unit(cameras: Sequence[Camera], points: np.ndarray) -> list[Camera]:
    """The cameras with the unit of their world. They stay as they are if one of them has another unit than 1:
    then their file names it.

    points (P, 3), world: sparse points, or means of Gaussians; there may be none. Their median distance from
    the middle of the cameras counts if it is larger than the cameras' extent."""
    if any(camera.unit != 1 for camera in cameras):
        return list(cameras)
    centres, distance = np.array([camera.position for camera in cameras]), 0.0
    if len(points):
        some = points[:: len(points) // MOST_POINTS + 1]
        distance = float(np.median(np.linalg.norm(some - centres.mean(axis=0), axis=1)))
    extent = extent_of(cameras)
    # less is what rounding leaves of cameras in one place
    size = max(extent if extent > 1e-6 * np.abs(centres).max() else 0.0, distance)
    return [replace(camera, unit=unit_of(size)) for camera in cameras]


def resized_valid(valid: np.ndarray, width: int, height: int) -> np.ndarray:
    """Camera.valid at another image size: pixels count of which every part did."""
    rows, columns = (
        np.arange(new) * old // new for new, old in zip((height, width), valid.shape, strict=True)
    )
    return np.minimum.reduceat(np.minimum.reduceat(valid, rows, axis=0), columns, axis=1)


def evenly(views: Sequence[View], count: int) -> list[View]:
    """At most `count` of the views, evenly spread in the list, with the first and the last one."""
    return [
        views[k]
        for k in np.unique(np.linspace(0, len(views) - 1, min(count, len(views))).round().astype(int))
    ]


def apart(views: Sequence[View], most: int) -> tuple[list[View], list[View]]:
    """Up to half of the views, at most `most`, evenly spread, to decide in; and the others, to measure in."""
    chosen = evenly(range(len(views)), min(most, len(views) // 2))
    return [views[k] for k in chosen], [view for k, view in enumerate(views) if k not in chosen]


def spaced(views: Sequence[View], count: int) -> list[View]:
    """At most `count` of the views: the first one, and others at equal distances in the list."""
    return list(views[:: max(1, len(views) // count)][:count])


def halfway(cameras: Sequence[Camera]) -> list[Camera]:
    """Views halfway between each camera and the next one in the list, with the intrinsics of the first one.
    There is none where the two look in directions more than a right angle apart."""
    between = list[Camera]()
    for a, b in itertools.pairwise(cameras):
        # the rotation nearest to the sum of two is the one halfway; 2 cos(angle / 2) is a singular value
        U, values, Vt = np.linalg.svd(a.viewmat[:3, :3] + b.viewmat[:3, :3])
        if values[-1] >= math.sqrt(2):
            viewmat = np.eye(4)
            viewmat[:3, :3] = U @ Vt
            viewmat[:3, 3] = -viewmat[:3, :3] @ (a.position + b.position) / 2
            name = f"between_{len(between):03d}"
            between.append(replace(a, viewmat=viewmat, name=name, valid_bits=None))
    return between


def view_stem(name: str) -> str:
    """The image name, with its folders, without an extension; a number, as in 'frame.0001', is none."""
    path = PurePosixPath(name)
    return str(path if path.suffix[1:].isdecimal() else path.with_suffix(""))


def refuse_same_stems(cameras: Iterable[Camera], advice: str):
    """Raises SceneError if the files of one view, which are named after its stem, would replace those of
    another. advice: what to do."""
    by_stem: dict[str, Camera] = {}
    for camera in cameras:
        other = by_stem.setdefault(view_stem(camera.name), camera)
        if other is not camera:
            raise SceneError(
                f"views '{other.name}' and '{camera.name}' would be written to the same files; {advice}"
            )
