"""Mini-Splatting (arXiv 2403.14166): its two simplifications. The first draws Gaussians in proportion to
their importance (../scores.py), the second keeps the most important ones that together have 99 % of it.
Published at steps 15 000, when densification ends, and 20 000 of 30 000.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..run_view import Keep, RunView
from ..scores import drawn, importance
from ..viewed_scene import ViewedScene
from .stepwise import Stepwise

SAMPLED = 0.5  # share of the Gaussians with an importance above 0 that the first simplification draws
KEPT = 0.99  # share of the importance that the second keeps


@dataclass
class MiniSplatting(Stepwise):
    EVENTS: ClassVar = (0.0, 1 / 3)
    by_area: bool = False

    def ranking_passes(self, settings, steps, share):
        return [(0.0, share)] if settings.target else super().ranking_passes(settings, steps, share)

    def score(self, viewed: ViewedScene) -> np.ndarray:
        return importance(viewed, self.by_area)

    def event(self, run: RunView, done: int) -> Keep:
        """With a target the first draws as many Gaussians, and the second does nothing."""
        first = run.model.count == self.count  # nothing is drawn yet
        if run.target and not first:
            return None
        scores = self.score(run.viewed)
        if first:
            return drawn(
                scores, run.target or int(SAMPLED * (scores > 0).sum()), [run.plan.seed, 5, run.iteration]
            )
        order = np.argsort(scores, kind="stable")
        keep = np.empty(len(scores), bool)
        keep[order] = np.cumsum(scores[order]) > (1 - KEPT) * scores.sum()
        return keep


METHODS = (
    MiniSplatting(
        "minisplatting",
        "draws Gaussians in proportion to what they add to the photographs (sum of αT)",
        22,
        "Mini-Splatting",
        source="Mini-Splatting, arXiv 2403.14166",
    ),
    MiniSplatting(
        "minisplatting-outdoor",
        "Mini-Splatting by the mean of αT, for outdoor scenes",
        23,
        "Mini-Splatting, Outdoor",
        by_area=True,
        source="Mini-Splatting, arXiv 2403.14166",
    ),
)
