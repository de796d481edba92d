"""Methods that learn nothing: Gaussians are ranked once by a score and the target count stays. What follows is recovery.

PUP 3D-GS (arXiv 2406.10219): sensitivity.py; here in one cut, where it is published with two and a recovery after each.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import scores
from ..sensitivity import log_determinants
from .base import Keep, Method

if TYPE_CHECKING:
    from ..loop import Run


def opacity(scene, cameras, rasterizer, options) -> np.ndarray:
    return scene.opacity_logits


def contribution(scene, cameras, rasterizer, options) -> np.ndarray:
    """Sum of alpha T over all pixels of all views."""
    return scores.contribution(scene, cameras, rasterizer, options)[0]


def max_contribution(scene, cameras, rasterizer, options) -> np.ndarray:
    """Largest alpha T in any pixel of any view (RadSplat)."""
    return scores.contribution(scene, cameras, rasterizer, options)[1]


@dataclass
class Ranked(Method):
    """rank(scene, cameras, rasterizer, options): (N,), the higher the more important."""

    rank: Callable[..., np.ndarray] = opacity
    ranks: bool = True

    def decided(self, run: Run) -> Keep:
        return scores.top(self.score(run.model, run.training_cameras, run.engine.rasterizer, run.score_options), run.target)

    def score(self, scene, cameras, rasterizer, options) -> np.ndarray:
        return self.rank(scene, cameras, rasterizer, options)


VARIANTS = {
    "opacity": Ranked(rank=opacity),
    "contribution": Ranked(rank=contribution),
    "max-contribution": Ranked(rank=max_contribution),
    "pup": Ranked(rank=log_determinants),
}
