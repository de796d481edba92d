"""Base class of methods that cut in several events, with plain training in between."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Phase, Rates, Settings
from .base import Method, learning_phase


@dataclass
class Stepwise(Method):
    """A subclass defines EVENTS, the shares of the phase after which it cuts. In training the shares are
    those of the steps that are left when densification ends."""

    EVENTS: ClassVar[tuple[float, ...]]
    count: int = 0  # state: number of Gaussians before the first event

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        return learning_phase(iterations, Rates(position_first=5e-6, position_steps=iterations))

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        return [(event, share ** ((k + 1) / len(self.EVENTS))) for k, event in enumerate(self.EVENTS)]

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        begun = self.begun(phase)
        steps = [max(1, begun + round(share * (phase.steps - begun))) for share in self.EVENTS]
        if number not in steps:
            return None
        self.count = self.count or run.model.count
        return self.event(run, sum(step <= number for step in steps))

    @staticmethod
    def begun(phase: Phase) -> int:
        """The step after which the events begin: the last one with densification, or 0."""
        return min(phase.densify.until, phase.steps) if phase.densify else 0

    def event(self, run: RunView, done: int) -> Keep:
        """The Gaussians that stay at an event: those of highest score. Their number falls by the same ratio
        at each event, to the target. done: number of events, with this one."""
        return self.highest(run, self.falling(run, done))

    def falling(self, run: RunView, done: int) -> int:
        """The number of Gaussians after `done` events that falls by the same ratio at each, to the target."""
        return round(self.count * (min(run.target, self.count) / self.count) ** (done / len(self.EVENTS)))

    def highest(self, run: RunView, count: int) -> np.ndarray:
        """(N,) bool: the `count` Gaussians of highest score."""
        return top(self.score(run.viewed), count)

    def state(self) -> dict:
        return {"count": self.count}

    def restore(self, state: dict):
        self.count = state["count"]
