"""A composite as render passes: linear colour times alpha in a working space, and every other pass by name.

Passes are linear; the view transform Standard gives back the display colours of training.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..camera import Camera
from ..files.images import srgb_to_linear
from ..native import Rasterizer
from ..outputs import OUTPUTS
from ..scene import Scene
from .composite import FAR, Composite, composite
from .mesh_depth import Surface

PASSES = tuple(output.render_pass for output in OUTPUTS.values() if output.render_pass)  # name, channels and kind of each, but Combined
SRGB_PRIMARIES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def linear_rgba(picture: Composite, transparent: bool, working_space: Sequence = SRGB_PRIMARIES) -> np.ndarray:
    """(H, W, 4) float32 linear colour times alpha: a view transform that only encodes gives back the picture.

    transparent: the picture was made over black, and what it does not cover is to stay clear. working_space: what linear
    red, green and blue of sRGB are there, (3, 3).
    """
    alpha = picture.covered[..., None] if transparent else np.ones_like(picture.alpha)[..., None]
    straight = np.divide(picture.rgb, alpha, out=np.zeros_like(picture.rgb), where=alpha > 0)
    return np.concatenate([srgb_to_linear(straight) @ np.asarray(working_space, np.float32) * alpha, alpha], axis=-1)


def passes(picture: Composite, transparent: bool, unit: float, working_space: Sequence) -> dict[str, np.ndarray]:
    """Combined (H, W, 4) and PASSES (H, W), float32; unit: length of one unit of the picture's depth in the renderer."""
    images = {found[0]: image for name, image in picture.images.items() if (found := OUTPUTS[name].render_pass)}
    depth = np.where(picture.depth < FAR, picture.depth * np.float32(unit), np.float32(FAR))
    return {"Combined": linear_rgba(picture, transparent, working_space), **images, "Depth": depth}


def blank(height: int, width: int) -> dict[str, np.ndarray]:
    """Passes of a picture that could not be drawn."""
    return {"Combined": np.zeros((height, width, 4), np.float32)} | {name: np.zeros((height, width), np.float32) for name, *_ in PASSES}


def overlay_rgba(rasterizer: Rasterizer, scene: Scene, camera: Camera, hidden: np.ndarray) -> np.ndarray:
    """(H, W, 4) display sRGB times alpha of Gaussians to be laid over a picture whose depth (H, W) is `hidden`, infinite where empty."""
    picture = composite(rasterizer, scene, camera, surface=Surface(hidden, np.zeros((*hidden.shape, 3), np.float32)))
    return np.concatenate([picture.rgb, picture.alpha[..., None]], axis=-1)
