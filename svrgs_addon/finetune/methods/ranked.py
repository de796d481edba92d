"""What methods share that learn nothing: Gaussians are ranked once by a score, the highest stay up to the target, and recovery follows."""

from __future__ import annotations

from dataclasses import dataclass

from ..scores import top
from .base import Keep, Method, RunView


@dataclass
class Ranked(Method):
    """A subclass defines score()."""

    ranks: bool = True

    def final_mask(self, run: RunView) -> Keep:
        return top(self.score(run.model, run.training_cameras, run.rasterizer, run.score_options), run.target)
