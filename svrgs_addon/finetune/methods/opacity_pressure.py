"""The pressure of GNS (arXiv 2511.16980) on all opacity logits, until few enough Gaussians withstand it; gns and pressure share it.

    r (mean((l + 20) / max(0.05, 1 - o)))^2  in the first eighth of the phase, then  3 r (mean(l) + 20)^2

r is adapted so that the opacity at the rank of the budget falls linearly to 0. Published: 8000 steps, the term in every 50th, r adapted
every 100, pruning of o < 0.001 after step 1000, the goal at 0 after step 7000. All scale with the length of the phase, but the term
never comes more often than every `least_between` steps: the photographs must decide what withstands it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model import Model
from ..penalties import OpacityPressure, sigmoid
from ..quality import fewest_within
from ..saliency import saliency
from ..scores import top
from ..settings import Densify, Phase, Rates
from .base import Keep, Method, RunView

STEPS, PRESS_EVERY, EASE = 8_000, 50, 1_000  # published; EASE: end of the first form, and of the high opacity rate after the trim
SHARE_OF_TRAINING = 8 / 23  # published: pressure from 15 000 to 23 000
OPACITY_RATE = 4 * 0.025
FINAL_OPACITY_RATE = 0.025
FIRST_GOAL, TOLERANCE, LOWER, RAISE = 0.8, 0.1, 0.8, 1.2
MIN_OPACITY = 0.001
NEAR = 1.05  # of the budget: so few are trimmed to it at once


@dataclass
class Pressed(Method):
    """State: r's factor, the first goal, and the step of the trim, 0 before it."""

    lambda_m: float = 2e-4  # r at the start
    goal_zero: float = 7_000 / STEPS  # share of the phase after which the opacity at the budget's rank should be 0
    least_between: int = 8  # steps
    supports_max_drop: bool = True  # by saliency; recovery_pruning.py spends what the recovery wins back
    factor: float = 1.0
    first_goal: float = 0.0
    trimmed: int = 0

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        """3DGS, then pressure in the last 8/23 of the iterations."""
        press = round(iterations * SHARE_OF_TRAINING)
        train, *recover = super().train_phases(iterations, recovery, densify, coarse_until)
        train = replace(train, steps=iterations - press, active=False)
        return [train, *pressure_phase(press, *(Rates().at(step, 1.0)["means"] for step in (train.steps, iterations))), *recover]

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        return [*pressure_phase(iterations, 5e-6, Rates().position_last), *super().prune_phases(iterations, recovery, prune_every)]

    def budget(self, run: RunView) -> int:
        """The fewest Gaussians, by saliency, within the allowed drop."""
        value = saliency(run.model, run.training_cameras, run.rasterizer, run.score_options)
        return int(fewest_within(run, value, run.psnr_before - run.settings.max_drop).sum())

    def prepare(self, run: RunView, phase: Phase, number: int):
        """Adapts r at every other pressed step: it falls where the opacity at the budget's rank is below the goal, and rises above it."""
        if not self._presses(phase, number):
            return
        reached = opacity_at(run.model.opacity_logits, run.target)
        if not self.first_goal:
            self.first_goal = FIRST_GOAL * reached
        elif (number - 1) % (2 * self.press_every(phase)) == 0:
            goal = max(0.0, 1 - (number - 1) / (phase.steps * self.goal_zero)) * self.first_goal
            self.factor *= LOWER if reached < (1 - TOLERANCE) * goal else RAISE if reached > (1 + TOLERANCE) * goal else 1

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        if self.trimmed:
            late = number > self.trimmed + phase.steps * EASE / STEPS
            return {"rates": phase.rates.at(number, run.extent) | {"opacity_logits": FINAL_OPACITY_RATE}} if late else {}
        if not self._presses(phase, number):
            return {}
        early = number <= phase.steps * EASE / STEPS
        r = run.settings.lambda_m * self.factor
        return {"penalty": OpacityPressure(r if early else 3 * r, early, self.shares(run))}

    def shares(self, run: RunView) -> np.ndarray | None:
        """(N,), 1 on average: the share of each Gaussian in the pressure; None: all alike."""
        return None

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        if self.trimmed:
            return None
        if run.model.count < NEAR * run.target or number == phase.steps:
            self.trimmed = number
            return drawn_by_opacity(run.model, run.target, [run.settings.seed, 2, run.iteration])
        if number % self.press_every(phase) or number < phase.steps * EASE / STEPS:
            return None
        return (run.model.opacity_logits >= logit(MIN_OPACITY)) | top(run.model.opacity_logits, run.target)

    def press_every(self, phase: Phase) -> int:
        """Steps from one pressed step to the next."""
        return max(self.least_between, round(phase.steps * PRESS_EVERY / STEPS))

    def _presses(self, phase: Phase, number: int) -> bool:
        return not self.trimmed and (number - 1) % self.press_every(phase) == 0

    def state(self) -> dict:
        return {"factor": self.factor, "first_goal": self.first_goal, "trimmed": self.trimmed}

    def restore(self, state: dict):
        self.factor, self.first_goal, self.trimmed = state["factor"], state["first_goal"], state["trimmed"]


def pressure_phase(steps: int, first: float, last: float) -> list[Phase]:
    """The phase under pressure, with the position rate falling from `first` to `last`; none for 0 steps."""
    rates = Rates(position_first=first, position_last=last, position_steps=steps, opacity=OPACITY_RATE)
    return [Phase("press", steps, rates, active=True, prune_every=0, label="Pressing opacities down")] if steps else []


def opacity_at(logits: np.ndarray, rank: int) -> float:
    """The opacity that `rank` Gaussians reach, of logits (N,)."""
    place = max(len(logits) - rank, 0)
    return float(sigmoid(np.partition(logits, place)[place].astype(np.float64), np))


def drawn_by_opacity(model: Model, count: int, key: list[int]) -> np.ndarray:
    """(N,) bool: `count` Gaussians drawn without replacement, with probabilities proportional to opacity (Gumbel noise on log opacity)."""
    log_opacity = -np.logaddexp(0, -model.opacity_logits.astype(np.float64))
    return top(log_opacity + np.random.default_rng(key).gumbel(size=model.count), count)


def logit(p: float) -> float:
    return float(np.log(p / (1 - p)))
