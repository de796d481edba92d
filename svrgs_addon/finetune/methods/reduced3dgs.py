"""Reduced-3DGS (arXiv 2406.17074): its pruning removes faint Gaussians where many cover the same place
(../redundancy.py), every 1000 steps until 3000 before the end, and invisible ones after densification. A
penalty lowers the opacity of the Gaussians that the view sees."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..penalties import MeanSeenOpacity, sigmoid
from ..redundancy import survivors
from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Phase, Settings
from .stepwise import Stepwise

# opacity below which Gaussians are removed, every so many steps; ten times as many lie between two events
INVISIBLE, EVERY = 1 / 255, 100


@dataclass
class Reduced3DGS(Stepwise):
    EVENTS: ClassVar = tuple(k / 15 for k in range(13))
    lambda_m: float = 1e-3

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        return []  # its events render nothing

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        return {"penalties": (MeanSeenOpacity(run.plan.lambda_m),)}

    def after_densification(self, run: RunView, phase: Phase, number: int) -> Keep:
        due = phase.densify and number % (10 * EVERY) == 0 and number % phase.densify.reset_every
        return survivors(run.model, run.viewed.cameras) if due else None

    def event(self, run: RunView, done: int) -> Keep:
        # with a target what the rule keeps comes first, then what has a higher opacity
        keep = survivors(run.model, run.viewed.cameras)
        return (
            top(keep + sigmoid(run.model.opacity_logits, np), self.falling(run, done)) if run.target else keep
        )

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        keep, logits = super().after_step(run, phase, number), run.model.opacity_logits
        if keep is not None or number % EVERY:
            return keep
        return (sigmoid(logits, np) >= INVISIBLE) | top(logits, run.target)


METHODS = (
    Reduced3DGS(
        "reduced3dgs",
        "removes faint Gaussians from places that many Gaussians cover",
        24,
        "Reduced-3DGS",
        source="Reduced-3DGS, arXiv 2406.17074",
    ),
)
