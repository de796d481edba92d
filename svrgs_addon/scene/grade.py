"""Colour grading of a splat: an affine map of display sRGB colours and a factor on opacities.

    c' = A c + b

c is the colour of a Gaussian from a view, and linear in its SH coefficients. So the map of all coefficients
gives the graded colour in every view, up to the clamp at 0.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from .gaussians import SH_C0, Scene

GAMMA = 2.2  # about that of display sRGB: a gain of 2^(1 / GAMMA) is a stop of light
LUMA = np.array([0.2126, 0.7152, 0.0722])  # of Rec. 709
MIDDLE = 0.5  # which contrast leaves as it is
MOST_OPAQUE = 1 - 1e-6

Rows = tuple[tuple[float, ...], ...]


@dataclass(frozen=True)
class Grade:
    """exposure: stops of light, about. warmth: stops of red over blue. tint: stops of magenta over green.
    saturation: 0 grey, 1 as it is. contrast: 1 as it is. opacity: factor on opacities, 0 to 1. crop: the rows
    of a (4, 4) affine matrix from the scene's coordinates to a cube of -1 to 1 outside which nothing stays;
    None: all does. softness: over what share of the way from its faces to its middle opacity grows."""

    exposure: float = 0.0
    warmth: float = 0.0
    tint: float = 0.0
    saturation: float = 1.0
    contrast: float = 1.0
    opacity: float = 1.0
    crop: Rows | None = None
    softness: float = 0.0

    @property
    def matrix(self) -> np.ndarray:
        """(3, 4) float64: (A | b). White balance and exposure come first, then saturation, then contrast."""
        stops = self.exposure + np.array([self.warmth + self.tint, -self.tint, self.tint - self.warmth]) / 2
        gains = np.diag(2.0 ** (stops / GAMMA))
        grey = self.saturation * np.eye(3) + (1 - self.saturation) * LUMA
        return np.column_stack([self.contrast * grey @ gains, np.full(3, MIDDLE * (1 - self.contrast))])


def inside(means: np.ndarray, grade: Grade) -> np.ndarray:
    """What the crop makes of opacities: factors (N,) float64 in 0..1, smooth steps. means: centres (N, 3)."""
    if grade.crop is None:
        return np.ones(len(means))
    matrix = np.array(grade.crop)
    depths = 1 - np.abs(means.astype(np.float64) @ matrix[:3, :3].T + matrix[:3, 3]).max(axis=1)
    if not grade.softness:
        return (depths >= 0).astype(np.float64)
    share = np.clip(depths / grade.softness, 0, 1)
    return share * share * (3 - 2 * share)


def graded(scene: Scene, grade: Grade) -> Scene:
    """The scene with other colours and opacities, without what is cropped away."""
    if grade == Grade():
        return scene
    factors = inside(scene.means, grade)
    if not factors.all():
        scene, factors = scene.select(factors > 0), factors[factors > 0]
    matrix = grade.matrix
    sh = (scene.sh @ matrix[:, :3].T.astype(np.float32)).astype(np.float32, copy=False)
    sh[:, 0] += ((matrix[:, :3].sum(axis=1) / 2 + matrix[:, 3] - 0.5) / SH_C0).astype(np.float32)
    scene = replace(scene, sh=np.ascontiguousarray(sh))
    factors *= grade.opacity
    if (factors == 1).all():
        return scene
    with np.errstate(over="ignore"):
        opacities = factors / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))
    opacities = np.clip(opacities, 1 - MOST_OPAQUE, MOST_OPAQUE)
    logits = np.log(opacities) - np.log1p(-opacities)
    return replace(scene, opacity_logits=logits.astype(np.float32))
