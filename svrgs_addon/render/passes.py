"""Converts a composite to Blender's render passes: Combined (linear colour times alpha) and all other passes
by name.

The colours of a composite are display sRGB, the colour space of training. Passes are linear, so they hold the
linear values, and Blender's view transform Standard gives back the display colours.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..native.outputs import OUTPUTS
from ..native.pictures import linear_colours
from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from .composite import FAR, Composite

# (name, channels, type) of each pass except Combined
PASSES = tuple(output.render_pass for output in OUTPUTS.values() if output.render_pass)
# a further pass, where Gaussians in front of and behind meshes are separate pictures
BEHIND = ("Behind", "RGBA", "COLOR")
SRGB_PRIMARIES = ((1, 0, 0), (0, 1, 0), (0, 0, 1))


def linear_rgba(
    picture: Composite, transparent: bool, working_space: Sequence = SRGB_PRIMARIES
) -> np.ndarray:
    """Linear colour times alpha, (H, W, 4) float32, in the working space. The view transform Standard gives
    back the picture.

    transparent: pixels that the picture does not cover stay transparent; the picture must have a black
    background. Holdouts are transparent in any case. working_space: (3, 3), the rows are linear red, green
    and blue of sRGB in the working space of the renderer.
    """
    return _linear(picture.rgb, picture.coverage if transparent else 1 - picture.holes, working_space)


def passes(
    picture: Composite, transparent: bool, unit: float, working_space: Sequence
) -> dict[str, np.ndarray]:
    """Combined (H, W, 4), PASSES (H, W) and, if the picture has it, Behind (H, W, 4), float32, by name.

    transparent, working_space: as in linear_rgba. unit: length of one unit of the picture's depth, in units
    of Blender's scene.
    """
    kinds = {name: OUTPUTS[name].render_pass for name in picture.images}
    images = {kind[0]: picture.images[name] for name, kind in kinds.items() if kind}
    depth = np.where(picture.depth < FAR, picture.depth * np.float32(unit), np.float32(FAR))
    layers = {"Combined": linear_rgba(picture, transparent, working_space), **images, "Depth": depth}
    if picture.behind is not None:
        layers[BEHIND[0]] = _linear(picture.behind[..., :3], picture.behind[..., 3], working_space)
    return layers


def blank(height: int, width: int, kinds: Sequence = PASSES) -> dict[str, np.ndarray]:
    """Combined and the passes of these kinds with zeros, for a picture that could not be drawn."""
    channels = {"Combined": 4} | {name: len(letters) for name, letters, _ in kinds}
    shape = lambda count: (height, width) if count == 1 else (height, width, count)
    return {name: np.zeros(shape(count), np.float32) for name, count in channels.items()}


def _linear(rgb: np.ndarray, alpha: np.ndarray, working_space: Sequence) -> np.ndarray:
    """Display sRGB times alpha (H, W, 3) -> linear colour times alpha, and alpha: (H, W, 4) float32."""
    return linear_colours(
        np.ascontiguousarray(rgb, np.float32), np.ascontiguousarray(alpha, np.float32), working_space
    )


def overlay_rgba(
    rasterizer: Rasterizer, scene: Scene, camera: Camera, hidden: np.ndarray | None
) -> np.ndarray:
    """Gaussians to be blended over a picture of other objects, (H, W, 4): display sRGB times alpha, and
    alpha.

    hidden: camera z (H, W) of that picture, infinite where it is empty; a pixel blends only Gaussians with a
    smaller z. None: it is empty everywhere.
    """
    options = RenderOptions(antialiased=scene.antialiased, picture_only=True)
    limit = None if hidden is None else np.ascontiguousarray(hidden, rasterizer.dtype)
    found = rasterizer.forward(scene, camera, options, outputs=("rgb", "alpha"), depth_limit=limit)
    return np.dstack([found["rgb"], found["alpha"]])
