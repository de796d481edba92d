"""MaskGaussian (arXiv 2412.20522): lambda_m (mean M)^2 over all Gaussians, in its three schedules and its post-training form."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..settings import Phase, Rates
from .base import Method
from .masked import Masked

if TYPE_CHECKING:
    from ..loop import Run

POST_WEIGHT = 0.2 * 0.1  # post-training: 0.1, inside the bracket that SSIM's 0.2 multiplies
POST_STEPS, FADE_EVERY = 5_000, 400  # its published length, and how often its rates fade in it
POST_POSITION = 3.09e-6  # where the position rate, stretched from 30 000 to 35 000 steps, stands at 30 000


@dataclass
class MaskGS(Masked):
    """window: shares of the phase between which the term counts; masks are drawn, and learn from the image, all the time."""

    lambda_m: float = 5e-4
    window: tuple[float, float] = (0.0, 1.0)

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        """Post-training: no pruning events, one decision at the end, rates fading."""
        fade = max(1, round(FADE_EVERY * iterations / POST_STEPS))
        rates = Rates(position_first=POST_POSITION, position_steps=iterations, decay=0.95, decay_every=fade)
        learn = Phase("prune", iterations, rates, active=True, prune_every=0)
        return [*([learn] if iterations else []), *Method.prune_phases(self, iterations, recovery, prune_every)]

    def weights(self, trained: bool) -> tuple[float, float]:
        return (0.0, POST_WEIGHT) if trained else super().weights(trained)

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        terms = super().terms(run, phase, number)
        first, last = (share * phase.steps for share in self.window)
        trained = phase.densify is None  # the window is one of training
        return terms if trained or first <= number <= last else terms | {"lambda_m": 0.0}


VARIANTS = {
    "maskgs": MaskGS(),
    "maskgs-alpha": MaskGS(lambda_m=0.1, window=(19 / 30, 20 / 30)),
    "maskgs-beta": MaskGS(),
    "maskgs-gamma": MaskGS(lambda_m=1e-3),
}
