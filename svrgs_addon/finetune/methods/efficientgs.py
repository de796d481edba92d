"""EfficientGS (arXiv 2404.12777): its pruning keeps the Gaussians that dominate a pixel of a training view,
that is, have the largest alpha T in it. Published at steps 15 000, when densification ends, 18 000 and 21 000
of 30 000."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..run_view import Keep, RunView
from ..scores import contribution, dominance, top
from ..viewed_scene import ViewedScene
from .stepwise import Stepwise


@dataclass
class EfficientGS(Stepwise):
    EVENTS: ClassVar = (0.0, 0.2, 0.4)

    def score(self, viewed: ViewedScene) -> np.ndarray:
        """The number of dominated pixels; equal numbers are ranked by the sum of alpha T, a fraction."""
        sums = contribution(viewed)[0]
        return dominance(viewed) + sums / (1 + sums.max(initial=0))

    def event(self, run: RunView, done: int) -> Keep:
        """With a target those of highest score stay: never fewer, and at the last event not more."""
        score = self.score(run.viewed)
        wanted = top(score, run.target)
        return wanted if run.target and done == len(self.EVENTS) else (score >= 1) | wanted


METHODS = (
    EfficientGS(
        "efficientgs",
        "removes the Gaussians that are not the strongest one in any pixel",
        25,
        "EfficientGS",
        source="EfficientGS, arXiv 2404.12777",
    ),
)
