"""Pruning by saliency in events: Gaussians with a saliency below lambda_F are removed (../saliency.py), and the others adapt.

Between two events, steps are plain 3DGS: no sampled masks, no F. From event to event the threshold rises geometrically from RAMP lambda_F
to lambda_F, because of two Gaussians that show the same thing only one may go. With a target the number that stays falls geometrically
instead; with an allowed drop, the fewest Gaussians stay that hold the event's share of it.
"""

from __future__ import annotations

from dataclasses import dataclass, field

from ..quality import fewest_within
from ..saliency import saliency
from ..scores import top
from ..settings import Phase, Rates, Settings
from .base import Keep, Method, RunView, learning_phase

EVENTS = 8  # in `svrgs prune`
RAMP = 0.01


@dataclass
class Saliency(Method):
    """State: the number of Gaussians before the first event."""

    lambda_f: float = 1e-3  # more than for pressure: the saliency of a Gaussian grows when its neighbours are gone
    lambda_f_help: str = field(default="the saliency below which a Gaussian is removed", repr=False)
    supports_max_drop: bool = True
    count: int = 0

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
        """The Gaussians that stay when the share `done` of the phase, 0..1, has passed."""
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


METHODS = (Saliency("saliency", "removes the Gaussians of low saliency in 8 events; plain training in between", 6),)
