"""Drawings as a renderer hands them on: linear colour times alpha in a working space, and every pass by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..camera import Camera
from ..files.images import srgb_to_linear
from ..native import Rasterizer
from ..scene import Scene
from .composite import FAR, Drawing, draw
from .mesh_depth import Surface

# Name, channels and kind of each pass beside Combined.
PASSES = (("Depth", "Z", "VALUE"), ("Alpha", "A", "VALUE"), ("SpatialMask", "X", "VALUE"), ("Count", "X", "VALUE"))
SRGB_PRIMARIES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def film(drawing: Drawing, transparent: bool, working_space: Sequence = SRGB_PRIMARIES) -> np.ndarray:
    """(H, W, 4) float32 linear colour times alpha: a view transform that only encodes gives back the drawing.

    transparent: the drawing was made over black, and what it does not cover is to stay clear. working_space: what linear
    red, green and blue of sRGB are there, (3, 3).
    """
    alpha = drawing.covered[..., None] if transparent else np.ones_like(drawing.alpha)[..., None]
    straight = np.divide(drawing.rgb, alpha, out=np.zeros_like(drawing.rgb), where=alpha > 0)
    return np.concatenate([srgb_to_linear(straight) @ np.asarray(working_space, np.float32) * alpha, alpha], axis=-1)


def passes(drawing: Drawing, transparent: bool, unit: float, working_space: Sequence) -> dict[str, np.ndarray]:
    """Combined (H, W, 4) and PASSES (H, W), float32; unit: length of one unit of the drawing's where depth is measured."""
    depth = np.where(drawing.depth < FAR, drawing.depth * np.float32(unit), np.float32(FAR))
    return {"Combined": film(drawing, transparent, working_space), "Depth": depth, "Alpha": drawing.alpha, "SpatialMask": drawing.mask, "Count": drawing.hits}


def blank(height: int, width: int) -> dict[str, np.ndarray]:
    """Passes of a picture that could not be drawn."""
    return {"Combined": np.zeros((height, width, 4), np.float32)} | {name: np.zeros((height, width), np.float32) for name, *_ in PASSES}


def lay(rasterizer: Rasterizer, scene: Scene, camera: Camera, hidden: np.ndarray) -> np.ndarray:
    """(H, W, 4) display sRGB times alpha of Gaussians to be laid over a picture whose depth (H, W) is `hidden`, infinite where empty."""
    drawing = draw(rasterizer, scene, camera, surface=Surface(hidden, np.zeros((*hidden.shape, 3), np.float32)))
    return np.concatenate([drawing.rgb, drawing.alpha[..., None]], axis=-1)
