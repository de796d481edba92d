"""Where a view may show Gaussians: discs in its picture, of balls around their means."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ...native.library import near_depth
from ...scene.camera import Camera
from .divided import Block

# how far a Gaussian is seen, in its largest scale and in pixels; share of its distance that rounding may
# change
SIGMAS, PIXELS, SLACK = 3.34, 2.0, 1e-3
PART = 1 << 18  # Gaussians that are tested together


@dataclass(frozen=True)
class Window:
    """A part of a picture, in pixels."""

    left: int
    top: int
    right: int
    bottom: int

    @classmethod
    def of(cls, camera: Camera) -> Window:
        """The whole picture."""
        return cls(0, 0, camera.width, camera.height)

    def halves(self) -> tuple[Window, Window]:
        """Cut across its longer side."""
        if self.right - self.left >= self.bottom - self.top:
            middle = (self.left + self.right) // 2
            return replace(self, right=middle), replace(self, left=middle)
        middle = (self.top + self.bottom) // 2
        return replace(self, bottom=middle), replace(self, top=middle)

    def seen_by(self, camera: Camera) -> Camera:
        """The camera of this part of its picture."""
        K = camera.K.copy()
        K[:2, 2] -= self.left, self.top
        width, height, valid = self.right - self.left, self.bottom - self.top, camera.valid
        part = replace(camera, K=K, width=width, height=height, valid_bits=None)
        return part if valid is None else part.masked(valid[self.slices])

    @property
    def slices(self) -> tuple[slice, slice]:
        """Its rows and columns."""
        return slice(self.top, self.bottom), slice(self.left, self.right)


@dataclass(frozen=True)
class Discs:
    """Boxes around what a view may show of balls, (n,) each: not where `front` is False."""

    front: np.ndarray
    left: np.ndarray  # pixels
    right: np.ndarray
    top: np.ndarray
    bottom: np.ndarray

    @classmethod
    def of(cls, points: np.ndarray, radius: np.ndarray, camera: Camera) -> Discs:
        """Of balls (n,) around points (n, 3). They leave room for what the rasterizer adds: it widens what a
        slanting ray meets, and adds a blur."""
        x, y, z = camera.viewmat[:3, :3] @ points.T + camera.viewmat[:3, 3:]
        depth = np.ones_like(z) if camera.orthographic else np.maximum(z, near_depth(camera.unit))
        front = z + radius + SLACK * np.abs(z) > near_depth(camera.unit)
        fx, fy, cx, cy = camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2]
        # more than 1 / cos of any ray, also of balls behind the camera
        stretch = 1.0 if camera.orthographic else 1 + camera.width / fx + camera.height / fy
        reach = (
            radius * max(fx, fy) * stretch / depth
            + PIXELS
            + SLACK * (np.abs(x) * fx + np.abs(y) * fy) / depth
        )
        u, v = x * fx / depth + cx, y * fy / depth + cy
        return cls(front, u - reach, u + reach, v - reach, v + reach)

    @classmethod
    def of_geometry(cls, geometry: np.ndarray, camera: Camera) -> Discs:
        """Of Gaussians, rows of the geometry (n, 11)."""
        radius = SIGMAS * np.exp(
            np.maximum(np.maximum(geometry[:, 3], geometry[:, 4]), geometry[:, 5]).astype(np.float64)
        )
        return cls.of(geometry[:, :3].astype(np.float64), radius, camera)

    def touch(self, window: Window) -> np.ndarray:
        """Which may be in the window, (n,) bool."""
        return (
            self.front
            & (self.right > window.left)
            & (self.left < window.right)
            & (self.bottom > window.top)
            & (self.top < window.bottom)
        )

    def around(self, camera: Camera, margin: int) -> Window | None:
        """The part of the picture that holds all of them, and so many pixels more on each side. None if that
        is nothing."""
        some = self.touch(Window.of(camera))
        if not some.any():
            return None
        left, top = (max(0, int(np.floor(side[some].min())) - margin) for side in (self.left, self.top))
        right = min(camera.width, int(np.ceil(self.right[some].max())) + margin)
        return Window(left, top, right, min(camera.height, int(np.ceil(self.bottom[some].max())) + margin))


def may_show(block: Block, camera: Camera) -> bool:
    """Whether a view may show a Gaussian of the block: not, if the ball around its box, with all its
    Gaussians, is outside."""
    middle, half = (block.low + block.high) / 2, np.linalg.norm(block.high - block.low) / 2
    ball = Discs.of(
        middle[None].astype(np.float64), np.array([half + SIGMAS * np.exp(float(block.largest))]), camera
    )
    return bool(ball.touch(Window.of(camera))[0])


def places_in(block: Block, camera: Camera) -> np.ndarray:
    """The places in the block of the Gaussians that a view may show, ascending."""
    return places_among(np.arange(block.count), block, camera, Window.of(camera))


def places_among(some: np.ndarray, block: Block, camera: Camera, window: Window) -> np.ndarray:
    """Those of these places in the block whose Gaussians a part of the view may show."""
    parts = [some[start : start + PART] for start in range(0, len(some), PART)]
    return np.concatenate(
        [some[:0], *(part[Discs.of_geometry(block.geometry[part], camera).touch(window)] for part in parts)]
    )
