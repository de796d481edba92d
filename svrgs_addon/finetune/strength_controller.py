"""Strength controller of methods that learn masks: it multiplies lambda_F and lambda_m by a strength, so that
learning ends at the target.

It is a proportional controller on log-strength; the error is the wanted slope minus the measured slope of the
progress q (docs/methods.md, "Strength controller"). q is 0 at the start of the phase and 1 at the goal:

- target count: q = ln(n_0 / n) / ln(n_0 / target); n is the expected number of Gaussians, n_0 the first n;
- allowed loss: q = (loss so far) / (allowed loss).

The wanted q is a line: 0 at the step where masks begin to change, 1 at HOLD_FROM of the phase, constant from
there on.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .run_view import RunView
from .settings import Phase, Settings

UPDATES = 100  # updates of the strength per phase
BEGUN = 0.02  # the line starts when q exceeds this ...
LATEST = 0.3  # ... or at this share of the phase
HOLD_FROM = 0.85  # share of the phase at which the line reaches 1
AHEAD = 0.08  # share of the phase after which the wanted slope would reach the line
GAIN = 0.8  # change of ln(strength) for an error as large as the slope of the line
SMOOTHING = 0.5  # weight of the newest measured slope in the smoothed one
LIMIT = math.log(1e4)  # largest |ln(strength)|, unless the method has a smaller bound


@dataclass
class StrengthController:
    """The controller. Its fields are its whole state; a checkpoint stores them."""

    log_strength: float = 0.0
    largest: float = LIMIT  # upper bound of log_strength
    start: float = 0.0  # n_0, or the quality at the start
    begun: int = 0  # t_0: step at which the line starts; 0: not yet
    last: float = 0.0  # q at the last update
    slope: float = 0.0  # smoothed measured slope of q, per step
    reached: int = 0  # Gaussians that would stay by the masks alone, at the last update

    @property
    def strength(self) -> float:
        """Factor on the weights of the method's terms."""
        return math.exp(self.log_strength)

    def before_step(self, run: RunView):
        """Called before each step of an active phase. At the first one it measures n_0 or the quality."""
        if not self.start and (run.target or run.plan.max_loss):
            self.start = run.quality_before if run.plan.max_loss else run.expected_count()

    def after_step(self, run: RunView, phase: Phase, number: int):
        """Updates the strength after step `number` of the phase."""
        every = max(1, phase.steps // UPDATES)
        if not self.start or number % every and number < phase.steps:
            return
        kept, own = run.current_mask(), run.own
        self.reached = run.model.count if kept is None else int((kept if own is None else kept[own]).sum())
        q = self.progress(run, (number / phase.steps) ** 2)
        self.slope += SMOOTHING * ((q - self.last) / every - self.slope)
        self.last = q
        if not self.begun and (q > BEGUN or number > LATEST * phase.steps):
            self.begun = number
        if self.begun:
            self._steer(phase, number)

    def _steer(self, phase: Phase, number: int):
        ahead = AHEAD * phase.steps
        length = max(HOLD_FROM * phase.steps - self.begun, ahead)
        line = min((number + ahead - self.begun) / length, 1.0)
        error = ((line - self.last) / ahead - self.slope) * length
        changed = self.log_strength + GAIN * min(max(error, -1.0), 1.0)
        self.log_strength = min(max(changed, -LIMIT), self.largest)

    def progress(self, run: RunView, settled: float) -> float:
        """q. For a target, n is a weighted mean: the number that would stay by the masks alone (weight
        `settled`, which rises from 0 to 1) and the sum of all p. So q is smooth at first and exact at the
        end."""
        if run.plan.max_loss:
            return (self.start - run.quality(run.current_mask())) / run.plan.max_loss
        if run.target >= self.start:
            return 1.0
        count = settled * self.reached + (1 - settled) * run.expected_count()
        return math.log(self.start / max(count, 1.0)) / math.log(self.start / run.target)


def controller_for(
    settings: Settings, learns_masks: bool, largest_strength: float
) -> StrengthController | None:
    """The controller of a run; None without target, share, max_loss, or if no masks are learned."""
    asked = settings.target or settings.share or settings.max_loss
    return StrengthController(largest=math.log(largest_strength)) if learns_masks and asked else None
