"""Meshes as a camera sees them: depth and colour of opaque triangles, with smooth edges.

A pixel at the edge of a mesh shows the mesh in a share of its area and what is behind it in the rest. So a
surface has a rest, which is the surface behind it in those pixels, and each of the two hides other Gaussians
(composite.py).

The light is fixed in Blender's world: bright from above and from the front left, as in a studio. So it is the
same from every camera.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from ..native.pictures import draw_triangles
from ..scene.camera import Camera
from .textures import Texture

AMBIENT = 0.62  # brightness of a surface at right angles to LIGHT
# added brightness of a surface with this normal: (x, y, z) of Blender's world
LIGHT = np.array([-0.12, -0.18, 0.32])


@dataclass(frozen=True)
class Triangles:
    """M opaque triangles in the camera's world, z up. Values are of corners and are interpolated."""

    corners: np.ndarray  # (M, 3, 3) float32: triangle, corner, coordinate
    normals: np.ndarray  # (M, 3, 3) float32, unit length
    colors: np.ndarray  # (M, 3, 3) float32, linear base colour; multiplied with the texture
    uvs: np.ndarray  # (M, 3, 2) float32
    texture: np.ndarray  # (M,) int32, index into `textures`; -1: none
    holdout: np.ndarray  # (M,) bool: a hole with alpha 0, which hides what is behind it
    textures: tuple[Texture, ...] = ()

    @cached_property
    def arrays(self) -> dict[str, np.ndarray]:
        """What the native library takes."""
        light = np.ascontiguousarray(self.normals @ LIGHT, np.float32)
        return {
            "corners": self.corners, "colors": self.colors, "light": light, "uvs": self.uvs,
            "textures": self.texture, "holdout": self.holdout.astype(np.uint8),
        }  # fmt: skip


@dataclass(frozen=True)
class Surface:
    """Triangles as a camera sees them."""

    depth: np.ndarray  # (H, W) float32, camera z; infinite where there is no triangle
    rgba: np.ndarray  # (H, W, 4) float32, display sRGB times alpha; alpha 0: a holdout, or no triangle
    share: np.ndarray | None = None  # (H, W) float32, how much of each pixel it has; None: all of every pixel
    rest: Surface | None = None  # what the rest of each pixel shows

    @classmethod
    def black(cls, depth: np.ndarray) -> Surface:
        """A surface that hides what is behind the depths (H, W), and shows nothing itself."""
        return cls(depth, np.zeros((*depth.shape, 4), np.float32))

    @property
    def holes(self) -> np.ndarray:
        """(H, W) float32: how much of each pixel shows a holdout."""
        here = np.isfinite(self.depth) - self.rgba[..., 3]
        if self.rest is None or self.share is None:
            return here
        return self.share * here + (1 - self.share) * self.rest.holes

    def scaled(self, factor: float) -> Surface:
        """The same surface with other units of length: depths are multiplied by `factor`."""
        return Surface(
            self.depth * np.float32(factor), self.rgba, self.share, self.rest and self.rest.scaled(factor)
        )


def surface(triangles: Triangles, camera: Camera) -> Surface | None:
    """The triangles as the camera sees them; None if it sees none. Raises NativeError."""
    if not len(triangles.corners):
        return None
    share, depth, rgba = draw_triangles(triangles.arrays, triangles.textures, AMBIENT, camera)
    if not np.isfinite(depth[0]).any():
        return None
    whole = share == 1
    if whole.all():
        return Surface(depth[0], rgba[0])
    return Surface(depth[0], rgba[0], share, Surface(depth[1], rgba[1]))
