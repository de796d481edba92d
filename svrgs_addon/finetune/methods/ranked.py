"""Base class of methods that rank: one cut keeps the Gaussians of highest score, as many as the target, and recovery follows."""

from __future__ import annotations

from dataclasses import dataclass

from ..scores import top
from .base import Keep, Method, RunView


@dataclass
class Ranked(Method):
    """A method that ranks. A subclass defines score()."""

    ranks: bool = True

    def final_mask(self, run: RunView) -> Keep:
        return top(self.score(run.model, run.training_cameras, run.rasterizer, run.score_options), run.target)
