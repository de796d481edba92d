"""Base class of methods that rank: one cut keeps those of highest score, as the target; then recovery."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Settings
from .base import Method


@dataclass
class Ranked(Method):
    """A method that ranks. A subclass defines score()."""

    ranks: bool = True

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        return [(0.0, share)]

    def cut(self, scene, cameras, rasterizer, options, count) -> np.ndarray:
        return top(self.score(scene, cameras, rasterizer, options), count)

    def final_mask(self, run: RunView) -> Keep:
        return self.cut(run.model, run.training_cameras, run.rasterizer, run.score_options, run.target)
