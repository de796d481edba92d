"""Steers the strength of a method that learns masks, so that the method itself arrives at the target.

Progress q is 0 at the start of the phase and 1 at the goal:
- target count: q = ln(E0 / E) / ln(E0 / target), E the expected number of Gaussians, E0 the first E;
- allowed drop: q = the drop in dB so far / the allowed drop.

q is to follow a line: from the step where masks begin to change up to 1 at HOLD_FROM of the phase, then constant. The controller is
a proportional controller on log-strength; the error is the wanted slope of q minus the measured slope.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from .run_view import RunView
from .settings import Phase, Settings

UPDATES = 100  # of the controller, in a phase
BEGUN = 0.02  # of q: the line starts where q exceeds this ...
LATEST = 0.3  # ... or at this share of the phase
HOLD_FROM = 0.85  # share of the phase
AHEAD = 0.08  # share of the phase: the wanted slope meets the line so far ahead
GAIN = 0.8  # change of ln(strength) for an error of one slope of the line
SMOOTHING = 0.5  # weight of the newest measured slope
LIMIT = math.log(1e4)  # of |ln(strength)|


@dataclass
class StrengthController:
    """State: everything here, as a checkpoint stores it."""

    log_strength: float = 0.0
    start: float = 0.0  # E0, or the PSNR at the start
    begun: int = 0  # step at which the line starts
    last: float = 0.0  # q at the last update
    slope: float = 0.0  # of q, per step, smoothed
    reached: int = 0  # Gaussians that the masks alone would leave, at the last update

    @property
    def strength(self) -> float:
        """Factor on the weights of the method's terms."""
        return math.exp(self.log_strength)

    def before_step(self, run: RunView):
        """Called before each step of an active phase: notes the start."""
        if not self.start and (run.target or run.settings.max_drop):
            self.start = run.psnr(None) if run.settings.max_drop else run.expected_count()

    def after_step(self, run: RunView, phase: Phase, number: int):
        """Updates the strength after step `number` of the phase."""
        every = max(1, phase.steps // UPDATES)
        if not self.start or number % every and number < phase.steps:
            return
        self.reached = run.model.count if (kept := run.current_mask()) is None else int(kept.sum())
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
        self.log_strength = min(max(self.log_strength + GAIN * min(max(error, -1.0), 1.0), -LIMIT), LIMIT)

    def progress(self, run: RunView, settled: float) -> float:
        """q. For a target, the count is a mean of what the masks alone would leave (weight `settled`) and E: smooth first, exact last."""
        if run.settings.max_drop:
            return (self.start - run.psnr(run.current_mask())) / run.settings.max_drop
        if run.target >= self.start:
            return 1.0
        count = settled * self.reached + (1 - settled) * run.expected_count()
        return math.log(self.start / max(count, 1.0)) / math.log(self.start / run.target)


def controller_for(settings: Settings, learns_masks: bool) -> StrengthController | None:
    """None where no target is asked for, or the method learns no masks."""
    asked = settings.target or settings.share or settings.max_drop
    return StrengthController() if learns_masks and asked else None
