"""Pruning by saliency (../saliency.py): a few events remove the Gaussians with a saliency below lambda_F; the others adapt in between.

Steps between two events are plain 3DGS: no sampled masks, no F. The threshold rises geometrically, from RAMP lambda_F to lambda_F at the
last event. It rises slowly because only one of two Gaussians that can replace each other may be removed. With a target, the number of
Gaussians falls geometrically instead. With an allowed drop, each event keeps the fewest Gaussians that hold its share of the drop.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..quality import fewest_within
from ..saliency import saliency
from ..scores import top
from ..settings import Phase, Rates, Settings
from .base import Keep, Method, RunView, learning_phase

EVENTS = 8  # number of events in `svrgs prune`
RAMP = 0.01  # first threshold over lambda_F


@dataclass
class Saliency(Method):
    """The method."""

    lambda_f: float = 1e-3  # larger than for pressure: the saliency of a Gaussian grows when its neighbours are removed
    lambda_f_help: str = field(default="the saliency below which a Gaussian is removed", repr=False)
    supports_max_drop: bool = True
    count: int = 0  # state: number of Gaussians before the first event

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        rates = Rates(position_first=5e-6, position_steps=iterations)
        return [*learning_phase(iterations, rates, max(1, iterations // EVENTS)), *super().prune_phases(iterations, recovery, prune_every)]

    def uses_lambda_f(self, settings: Settings) -> bool:
        return not (settings.target or settings.share or settings.max_drop)

    def after_step(self, run: RunView, phase: Phase, number: int) -> Keep:
        self.count = self.count or run.model.count
        if number != phase.steps and number % phase.prune_every:
            return None
        begun = min(phase.densify.until, phase.steps - 1) if phase.densify else 0
        return self.event(run, (number - begun) / (phase.steps - begun))

    def event(self, run: RunView, done: float) -> Keep:
        """The Gaussians that stay at an event. done: share of the phase that has passed, 0..1."""
        value = saliency(run.model, run.training_cameras, run.rasterizer, run.score_options)
        if run.settings.max_drop:
            return fewest_within(run, value, run.psnr_before - done * run.settings.max_drop)
        if run.target:
            return top(value, round(self.count * (min(run.target, self.count) / self.count) ** done))
        return value > run.settings.lambda_f * RAMP ** (1 - done)

    def state(self) -> dict:
        return {"count": self.count}

    def restore(self, state: dict):
        self.count = state["count"]


METHODS = (Saliency("saliency", "removes the Gaussians of lowest saliency in 8 steps, with plain training in between", 6, "Saliency"),)
