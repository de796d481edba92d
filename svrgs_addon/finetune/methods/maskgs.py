"""MaskGaussian (arXiv 2412.20522): the term lambda_m (mean M)^2, in three schedules and as post-training."""

from __future__ import annotations

from dataclasses import dataclass

from ..run_view import RunView
from ..settings import Phase, Rates
from .base import learning_phase
from .masked import Masked

# post-training: published as 0.1 inside the bracket that is multiplied by 0.2, the weight of SSIM
POST_WEIGHT = 0.02
# published number of steps of post-training; steps between two reductions of its rates
POST_STEPS, FADE_EVERY = 5_000, 400
# first position rate: that of the published schedule over 35 000 steps at step 30 000
POST_POSITION = 3.09e-6


@dataclass
class MaskGS(Masked):
    """The method. window: the part of the training, as shares, in which the term is added. Outside of it
    masks are sampled as well and get the gradient of the image loss."""

    lambda_m: float = 5e-4
    window: tuple[float, float] = (0.0, 1.0)

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        """Post-training as published: no pruning events, one decision at the end, falling learning rates."""
        fade = max(1, round(FADE_EVERY * iterations / POST_STEPS))
        rates = Rates(position_first=POST_POSITION, position_steps=iterations, decay=0.95, decay_every=fade)
        return learning_phase(iterations, rates)

    def weights(self, trained: bool) -> tuple[float, float]:
        return (0.0, POST_WEIGHT) if trained else super().weights(trained)

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        terms = super().terms(run, phase, number)
        first, last = (share * phase.steps for share in self.window)
        return terms if phase.densify is None or first <= number <= last else terms | {"lambda_m": 0.0}


LIKE_BETA = "when pruning, the same as MaskGaussian; in training, "

METHODS = (
    MaskGS(
        "maskgs",
        "learns the probability that each Gaussian exists and penalises the mean of all",
        7,
        "MaskGaussian",
        source="MaskGaussian, arXiv 2412.20522",
        halved=5.6,
    ),
    MaskGS(
        "maskgs-alpha",
        LIKE_BETA + "schedule alpha: a strong penalty from 19/30 to 20/30 of the steps",
        8,
        "MaskGaussian Alpha",
        lambda_m=0.1,
        window=(19 / 30, 20 / 30),
        source="MaskGaussian, arXiv 2412.20522",
    ),
    MaskGS(
        "maskgs-beta",
        LIKE_BETA + "schedule beta: a weak penalty in every step",
        9,
        "MaskGaussian Beta",
        source="MaskGaussian, arXiv 2412.20522",
    ),
    MaskGS(
        "maskgs-gamma",
        LIKE_BETA + "schedule gamma: twice the penalty of beta",
        10,
        "MaskGaussian Gamma",
        lambda_m=1e-3,
        source="MaskGaussian, arXiv 2412.20522",
    ),
)
