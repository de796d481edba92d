"""Steers the strength of a method that learns masks, so that it arrives at what was asked for by itself.

Progress q is 0 where the phase finds the scene and 1 at the goal: for a count, ln(E0 / E) / ln(E0 / target), E the expected number of
Gaussians that exist; for a loss of quality, the drop in dB so far over the one allowed. It is to rise evenly from where masks begin to
give way until HOLD_FROM of the phase, and then to stay. What is compared are speeds: the one that would meet the line a little
ahead, and the one q has; the logarithm of the strength moves by their difference.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from ..metrics.evaluate import mean_psnr
from .scores import top

if TYPE_CHECKING:
    from .loop import Run
    from .settings import Phase, Settings

LOOKS = 100  # at q, in a phase
BEGUN = 0.02  # of q: masks give way from here on ...
LATEST = 0.3  # ... or from this part of the phase on
HOLD_FROM = 0.85  # of the phase
AHEAD = 0.08  # of the phase
GAIN = 0.8  # of ln(strength), for a speed wrong by that of the line
SMOOTHING = 0.5  # of the speed seen
LIMIT = math.log(1e4)  # of |ln(strength)|
VIEWS = 6  # training views that the drop is measured on


@dataclass
class Control:
    """State: everything here, as a checkpoint holds it."""

    log_strength: float = 0.0
    start: float = 0.0  # E0, or the PSNR before
    begun: int = 0  # step from which the line rises
    last: float = 0.0  # q at the last look
    speed: float = 0.0  # of q, per step
    reached: int = 0  # Gaussians that masks alone would leave, at the last look

    @property
    def strength(self) -> float:
        """What the method's weights are multiplied by."""
        return math.exp(self.log_strength)

    def before(self, run: Run):
        """Called before each step of an active phase: notes where it starts from."""
        if not self.start and (run.target or run.settings.max_drop):
            self.start = psnr_of(run, None) if run.settings.max_drop else run.method.expected(run.model)

    def look(self, run: Run, phase: Phase, number: int):
        """After step `number` of the phase."""
        every = max(1, phase.steps // LOOKS)
        if not self.start or number % every and number < phase.steps:
            return
        self.reached = int(run.method.existing(run.model).sum())
        q = self.progress(run, (number / phase.steps) ** 2)
        self.speed += SMOOTHING * ((q - self.last) / every - self.speed)
        self.last = q
        if not self.begun and (q > BEGUN or number > LATEST * phase.steps):
            self.begun = number
        if self.begun:
            self._steer(phase, number)

    def _steer(self, phase: Phase, number: int):
        ahead = AHEAD * phase.steps
        length = max(HOLD_FROM * phase.steps - self.begun, ahead)
        line = min((number + ahead - self.begun) / length, 1.0)
        wrong = ((line - self.last) / ahead - self.speed) * length
        self.log_strength = min(max(self.log_strength + GAIN * min(max(wrong, -1.0), 1.0), -LIMIT), LIMIT)

    def progress(self, run: Run, settled: float) -> float:
        """q; of the number that counts, the share `settled` is what masks would leave, the rest E: smooth at first, exact at the end."""
        if run.settings.max_drop:
            return (self.start - psnr_of(run, run.method.existing(run.model))) / run.settings.max_drop
        if run.target >= self.start:
            return 1.0
        count = settled * self.reached + (1 - settled) * run.method.expected(run.model)
        return math.log(self.start / max(count, 1.0)) / math.log(self.start / run.target)


def control_for(settings: Settings, learns_masks: bool) -> Control | None:
    """None where nothing is asked for, or the method decides by itself."""
    return Control() if learns_masks and (settings.target or settings.share or settings.max_drop) else None


def psnr_of(run: Run, kept: np.ndarray | None) -> float:
    """dB over a few training views, spread over the dataset, of the Gaussians `kept` (N,) bool."""
    views = run.dataset.train_indices
    views = views[:: max(1, len(views) // VIEWS)][:VIEWS]
    return mean_psnr(run.model, run.dataset, views, run.engine.rasterizer, run.score_options, None if kept is None else kept.astype(np.uint8))


def fewest_within(run: Run, score: np.ndarray, floor: float) -> np.ndarray:
    """(N,) bool: the fewest of the highest scores with a PSNR (psnr_of) of `floor` dB at least, found by bisection."""
    few, enough = 0, run.model.count
    while enough - few > max(1, run.model.count // 1_000):
        middle = (few + enough) // 2
        within = psnr_of(run, top(score, middle)) >= floor
        few, enough = (few, middle) if within else (middle, enough)
    return top(score, enough)
