"""GNS (arXiv 2511.16980): its natural selection, a pressure on all opacity logits until the budget is met.
Densification is that of 3DGS.

    penalty = r (mean((l + 20) / max(0.05, 1 - o)))^2     in the first eighth of the phase
    penalty = 3 r (mean(l) + 20)^2                        after it

l are the opacity logits, o the opacities. r is adapted so that the opacity at the rank of the budget falls
linearly to 0. Published: 8000 steps, the penalty in every 50th step, r adapted every 100 steps, Gaussians
with o < 0.001 pruned after step 1000, the goal 0 after step 7000. All these numbers scale with the length of
the phase, except that two penalties are at least MIN_BETWEEN steps apart: in between, the photographs must
have time to raise the opacity of the Gaussians that they need.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from ..model import Model
from ..penalties import OpacityPressure, sigmoid
from ..quality import fewest_within
from ..run_view import Keep, RunView
from ..saliency import saliency
from ..scores import drawn, top
from ..settings import Phase, Rates
from .base import REMOVE, Method, learning_phase

# published; EASE: steps with the first form of the penalty, and with OPACITY_RATE after the trim
STEPS, PRESS_EVERY, EASE = 8_000, 50, 1_000
GOAL_ZERO = 7_000 / STEPS  # share of the phase after which the goal is 0
MIN_BETWEEN = 8  # steps from one pressed step to the next
SHARE_OF_TRAINING = 8 / 23  # published: pressure from step 15 000 to 23 000 of 23 000
OPACITY_RATE = 4 * 0.025  # learning rate of opacity logits until EASE steps after the trim
FINAL_OPACITY_RATE = 0.025  # the same, after that
FIRST_GOAL = 0.8  # the first goal, as a share of the opacity at the rank of the budget
# r is multiplied by LOWER or RAISE if this opacity differs by more than TOLERANCE from the goal
TOLERANCE, LOWER, RAISE = 0.1, 0.8, 1.2
MIN_OPACITY = 0.001  # Gaussians with less are removed
NEAR = 1.05  # times the budget: when fewer Gaussians are left, they are trimmed to the budget at once


@dataclass
class GNS(Method):
    """The method. A step with the penalty is called a pressed step."""

    lambda_m: float = 2e-4  # r at the start
    # the budget is found by saliency; recovery_pruning.py removes more in the recovery
    supports_max_loss: bool = True
    factor: float = 1.0  # state: factor on r
    first_goal: float = 0.0  # state: the goal at the first pressed step
    trimmed: int = 0  # state: step at which the Gaussians were trimmed to the budget; 0: not yet

    def train_phases(self, iterations, recovery, densify, coarse_until) -> list[Phase]:
        """Plain 3DGS, then pressure in the last 8/23 of the iterations, then recovery."""
        press = round(iterations * SHARE_OF_TRAINING)
        train, *recover = super().train_phases(iterations, recovery, densify, coarse_until)
        train = replace(train, steps=iterations - press, active=False)
        first, last = (train.rates.at(step, 1.0)["means"] for step in (train.steps, iterations))
        return [train, *(pressure_phase(press, first, last) if press else []), *recover]

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        return pressure_phase(iterations, 5e-6, Rates().position_last)

    def budget(self, run: RunView) -> int:
        """With an allowed drop: the number, of highest saliency, that holds it before any learning."""
        value = saliency(run.viewed)
        return int(fewest_within(run, value, run.quality_before - run.plan.max_loss).sum())

    def prepare(self, run: RunView, phase: Phase, number: int):
        """Adapts r at every other pressed step. r falls if the opacity at the rank of the budget is below the
        goal, and rises if it is above."""
        if not self._presses(phase, number):
            return
        reached = opacity_at(run.model.opacity_logits, run.target)
        if not self.first_goal:
            self.first_goal = FIRST_GOAL * reached
        elif (number - 1) % (2 * self.press_every(phase)) == 0:
            goal = max(0.0, 1 - (number - 1) / (phase.steps * GOAL_ZERO)) * self.first_goal
            if reached < (1 - TOLERANCE) * goal:
                self.factor *= LOWER
            elif reached > (1 + TOLERANCE) * goal:
                self.factor *= RAISE

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        if self.trimmed:
            late = number > self.trimmed + phase.steps * EASE / STEPS
            if late:
                return {"rates": phase.rates.at(number, run.extent) | {"opacity_logits": FINAL_OPACITY_RATE}}
            return {}
        if not self._presses(phase, number):
            return {}
        early = number <= phase.steps * EASE / STEPS
        r = run.plan.lambda_m * self.factor
        return {"penalties": (OpacityPressure(r if early else 3 * r, early),)}

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        if self.trimmed:
            return None
        if run.model.count < NEAR * run.target or number == phase.steps:
            self.trimmed = number
            return drawn_by_opacity(run.model, run.target, [run.plan.seed, 2, run.iteration])
        if number % self.press_every(phase) or number < phase.steps * EASE / STEPS:
            return None
        return (run.model.opacity_logits >= logit(MIN_OPACITY)) | top(run.model.opacity_logits, run.target)

    def press_every(self, phase: Phase) -> int:
        """The number of steps from one pressed step to the next."""
        return max(MIN_BETWEEN, round(phase.steps * PRESS_EVERY / STEPS))

    def _presses(self, phase: Phase, number: int) -> bool:
        return not self.trimmed and (number - 1) % self.press_every(phase) == 0

    def state(self) -> dict:
        return {"factor": self.factor, "first_goal": self.first_goal, "trimmed": self.trimmed}

    def restore(self, state: dict):
        self.factor, self.first_goal, self.trimmed = state["factor"], state["first_goal"], state["trimmed"]


def pressure_phase(steps: int, first: float, last: float) -> list[Phase]:
    """The phase with pressure. The position rate falls from `first` to `last`."""
    rates = Rates(position_first=first, position_last=last, position_steps=steps, opacity=OPACITY_RATE)
    return learning_phase(steps, rates, label=REMOVE)


def opacity_at(logits: np.ndarray, rank: int) -> float:
    """The opacity that `rank` Gaussians reach: the rank-th largest. logits (N,)."""
    place = max(len(logits) - rank, 0)
    return float(sigmoid(np.partition(logits, place)[place].astype(np.float64), np))


def drawn_by_opacity(model: Model, count: int, key: list[int]) -> np.ndarray:
    """(N,) bool: `count` Gaussians drawn without replacement, with probabilities proportional to opacity."""
    return drawn(sigmoid(model.opacity_logits.astype(np.float64), np), count, key)


def logit(p: float) -> float:
    return float(np.log(p / (1 - p)))


METHODS = (
    GNS(
        "gns",
        "lowers all opacities with the same pressure and removes the Gaussians that fade",
        12,
        "GNS",
        share=0.25,
        source="GNS, arXiv 2511.16980",
    ),
)
