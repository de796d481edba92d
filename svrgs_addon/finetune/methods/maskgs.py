"""MaskGaussian (arXiv 2412.20522): lambda_m (mean M)^2 over all Gaussians, in its three schedules and its post-training form."""

from __future__ import annotations

from dataclasses import dataclass

from ..settings import Phase, Rates
from .base import Method, RunView, learning_phase
from .masked import Masked

POST_WEIGHT = 0.2 * 0.1  # post-training: 0.1, within the bracket that SSIM's 0.2 multiplies
POST_STEPS, FADE_EVERY = 5_000, 400  # its published length; steps between two reductions of its rates
POST_POSITION = 3.09e-6  # the position rate of its stretched schedule at step 30 000


@dataclass
class MaskGS(Masked):
    """window: shares of the training between which the term counts. Masks are sampled, and learn from the image, all the time."""

    lambda_m: float = 5e-4
    window: tuple[float, float] = (0.0, 1.0)

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        """Post-training: no pruning events, one decision at the end, falling rates."""
        fade = max(1, round(FADE_EVERY * iterations / POST_STEPS))
        rates = Rates(position_first=POST_POSITION, position_steps=iterations, decay=0.95, decay_every=fade)
        return [*learning_phase(iterations, rates, 0), *Method.prune_phases(self, iterations, recovery, prune_every)]

    def weights(self, trained: bool) -> tuple[float, float]:
        return (0.0, POST_WEIGHT) if trained else super().weights(trained)

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        terms = super().terms(run, phase, number)
        first, last = (share * phase.steps for share in self.window)
        return terms if phase.densify is None or first <= number <= last else terms | {"lambda_m": 0.0}


METHODS = (
    MaskGS("maskgs", "MaskGaussian: penalises the mean of all masks, the same as maskgs-beta", 7),
    MaskGS("maskgs-alpha", "MaskGaussian, schedule alpha: a strong penalty from 19/30 to 20/30 of the training", 8, lambda_m=0.1, window=(19 / 30, 20 / 30)),
    MaskGS("maskgs-beta", "MaskGaussian, schedule beta: a weak penalty all the time", 9),
    MaskGS("maskgs-gamma", "MaskGaussian, schedule gamma: twice the penalty of beta", 10, lambda_m=1e-3),
)
