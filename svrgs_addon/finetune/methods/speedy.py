"""Speedy-Splat (arXiv 2412.00578): ranks by the squared slope of the pictures in the value G of a Gaussian
(../scores.py), in several cuts.

Soft pruning: three cuts while training densifies, each of 80 %. Hard pruning: five cuts after it, each of 30
%; then refinement. For 30 000 steps and densification until step 15 000 the cuts are at the published steps 6
000, 9 000, ... 27 000.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

from ..run_view import Keep, RunView
from ..scores import slopes
from ..settings import Phase
from .stepwise import Stepwise

# shares of the steps with densification; share of the Gaussians that stays
SOFT_CUTS, SOFT_KEPT = (0.4, 0.6, 0.8), 0.2
HARD_KEPT = 0.7


@dataclass
class Speedy(Stepwise):
    EVENTS: ClassVar = (0.0, 0.2, 0.4, 0.6, 0.8)
    share: float = HARD_KEPT**5

    def after_densification(self, run: RunView, phase: Phase, number: int) -> Keep:
        rule = phase.densify
        due = rule and any(number - rule.every < share * rule.until <= number for share in SOFT_CUTS)
        return self.highest(run, round(SOFT_KEPT * run.model.count)) if due else None


METHODS = (
    Speedy(
        "speedy",
        "removes, in 5 cuts, the Gaussians whose strength changes the photographs least",
        20,
        "Speedy-Splat",
        source="Speedy-Splat, arXiv 2412.00578",
        ranking=slopes,
    ),
)
