"""GNS (arXiv 2511.16980): a pressure on all opacity logits, now and then, until few enough Gaussians withstand it.

    r (mean((l + 20) / max(0.05, 1 - o)))^2  in the first eighth of the phase, then  3 r (mean(l) + 20)^2

r is adapted so that the opacity at the rank of the budget falls linearly to 0. Published: 8000 steps, a push every 50, r looked at
every 100, pruning of o < 0.001 after 1000, the goal at 0 after 7000; all scale with the length of the phase, but pushes never come
closer than `least_between`: what withstands them must be up to the photographs.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from ..model import Model
from ..penalties import OpacityPressure, sigmoid
from ..saliency import worth
from ..scores import top
from ..settings import Densify, Phase, Rates
from ..strength_controller import fewest_within
from .base import Keep, Method

if TYPE_CHECKING:
    from ..loop import Run

STEPS, PUSH_EVERY, EASE, GOAL_ZERO = 8_000, 50, 1_000, 7_000  # published; EASE: end of the first form, and of the opacity rate after the trim
SHARE_OF_TRAINING = 8 / 23  # published: pressure from 15 000 to 23 000
OPACITY_RATE = 4 * 0.025
CALM_OPACITY_RATE = 0.025
FIRST_GOAL, TOLERANCE, LOWER, RAISE = 0.8, 0.1, 0.8, 1.2
MIN_OPACITY = 0.001
NEAR = 1.05  # of the budget: so few are trimmed to it at once


@dataclass
class GNS(Method):
    """State: r's factor, where the goal starts, and the step of the trim, 0 before."""

    lambda_m: float = 2e-4  # r at first
    share: float = 0.25
    holds_drop: bool = True  # by what is worth most; what is won back is spent afterwards (closing.py)
    goal_zero: float = GOAL_ZERO / STEPS  # share of the phase after which the opacity at the budget's rank should be 0
    least_between: int = 8  # steps from one push to the next
    factor: float = 1.0
    first_goal: float = 0.0
    trimmed: int = 0

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        """3DGS, and pressure in the last 8/23 of the iterations."""
        press = round(iterations * SHARE_OF_TRAINING)
        train, *recover = super().train_phases(iterations, recovery, densify, coarse_until)
        train = replace(train, steps=iterations - press, active=False)
        return [train, *_pressure(press, *(Rates().at(step, 1.0)["means"] for step in (train.steps, iterations))), *recover]

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        return [*_pressure(iterations, 5e-6, Rates().position_last), *super().prune_phases(iterations, recovery, prune_every)]

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        if not run.target:
            value = worth(run.model, run.training_cameras, run.engine.rasterizer, run.score_options)
            run.target = int(fewest_within(run, value, run.closing.start - run.settings.max_drop).sum())
        rates = phase.rates.at(number, run.extent)
        if self.trimmed:
            calm = number > self.trimmed + phase.steps * EASE / STEPS
            return {"rates": rates | {"opacity_logits": CALM_OPACITY_RATE}} if calm else {}
        if (number - 1) % self.push_every(phase):
            return {}
        self._adapt(run, phase, number)
        early = number <= phase.steps * EASE / STEPS
        r = run.settings.lambda_m * self.factor
        return {"penalty": OpacityPressure(r if early else 3 * r, early, self.shares(run, phase, number))}

    def shares(self, run: Run, phase: Phase, number: int) -> np.ndarray | None:
        """What each Gaussian's part in the pressure counts (N,), 1 on average; None: all alike."""
        return None

    def _adapt(self, run: Run, phase: Phase, number: int):
        """Every other push: r falls where the opacity at the budget's rank is ahead of the goal, and rises where it is behind."""
        reached = opacity_at(run.model.opacity_logits, run.target)
        if not self.first_goal:
            self.first_goal = FIRST_GOAL * reached
        elif (number - 1) % (2 * self.push_every(phase)) == 0:
            goal = max(0.0, 1 - (number - 1) / (phase.steps * self.goal_zero)) * self.first_goal
            self.factor *= LOWER if reached < (1 - TOLERANCE) * goal else RAISE if reached > (1 + TOLERANCE) * goal else 1

    def after_step(self, run: Run, phase: Phase, number: int) -> Keep:
        if self.trimmed:
            return None
        if run.model.count < NEAR * run.target or number == phase.steps:
            self.trimmed = number
            return drawn_by_opacity(run.model, run.target, [run.settings.seed, 2, run.iteration])
        if number % self.push_every(phase) or number < phase.steps * EASE / STEPS:
            return None
        return (run.model.opacity_logits >= logit(MIN_OPACITY)) | top(run.model.opacity_logits, run.target)

    def push_every(self, phase: Phase) -> int:
        """Steps between two pushes."""
        return max(self.least_between, round(phase.steps * PUSH_EVERY / STEPS))

    def state(self) -> dict:
        return {"factor": self.factor, "first_goal": self.first_goal, "trimmed": self.trimmed}

    def restore(self, state: dict):
        self.factor, self.first_goal, self.trimmed = state["factor"], state["first_goal"], state["trimmed"]


def opacity_at(logits: np.ndarray, rank: int) -> float:
    """The opacity that `rank` Gaussians reach, of logits (N,)."""
    place = max(len(logits) - rank, 0)
    return float(sigmoid(np.partition(logits, place)[place].astype(np.float64), np))


def drawn_by_opacity(model: Model, count: int, key: list[int]) -> np.ndarray:
    """(N,) bool: `count` Gaussians drawn without replacement, each as likely as it is opaque (by Gumbel noise on log opacity)."""
    log_opacity = -np.logaddexp(0, -model.opacity_logits.astype(np.float64))
    return top(log_opacity + np.random.default_rng(key).gumbel(size=model.count), count)


def logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


def _pressure(steps: int, first: float, last: float) -> list[Phase]:
    rates = Rates(position_first=first, position_last=last, position_steps=steps, opacity=OPACITY_RATE)
    return [Phase("press", steps, rates, active=True, prune_every=0)] if steps else []
