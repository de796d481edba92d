"""SVR-GS without sampling: now and then, what is worth less than lambda_F to the objective goes (worth.py), and the rest adapts.

Between two events, steps are plain 3DGS: no noise of sampled masks, no F to draw. The threshold rises from RAMP lambda_F to lambda_F
from event to event, geometrically, for of two Gaussians that stand for each other only one may go. With a target the number left
falls geometrically instead; with a drop in dB, it is the fewest that stay within the event's share of it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from ..saliency import worth
from ..scores import top
from ..settings import Phase, Rates, Settings
from ..strength_controller import fewest_within, psnr_of
from .base import Keep, Method

if TYPE_CHECKING:
    from ..loop import Run

EVENTS = 8  # in `svrgs prune`
RAMP = 0.01


@dataclass
class Differences(Method):
    """State: Gaussians, and the PSNR of a few training views, before the first event."""

    lambda_f: float = 1e-3  # more than for svr: what others no longer stand in for is worth more
    holds_drop: bool = True
    count: int = 0
    psnr: float = 0.0

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        every = max(1, iterations // EVENTS)
        learn = Phase("prune", iterations, Rates(position_first=5e-6, position_steps=iterations), active=True, prune_every=every)
        return [*([learn] if iterations else []), *super().prune_phases(iterations, recovery, prune_every)]

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        if run.settings.max_drop and not self.psnr:
            self.psnr = psnr_of(run, None)
        return {}

    def weighs(self, settings: Settings) -> bool:
        return not (settings.target or settings.share or settings.max_drop)

    def after_step(self, run: Run, phase: Phase, number: int) -> Keep:
        self.count = self.count or run.model.count
        if number != phase.steps and number % phase.prune_every:
            return None
        begun = min(phase.densify.until, phase.steps - 1) if phase.densify else 0
        return self.worth_keeping(run, (number - begun) / (phase.steps - begun))

    def worth_keeping(self, run: Run, done: float) -> Keep:
        """What stays when the share `done` of the phase has passed, 0..1."""
        value = worth(run.model, run.training_cameras, run.engine.rasterizer, run.score_options)
        if run.settings.max_drop:
            return fewest_within(run, value, self.psnr - done * run.settings.max_drop)
        if run.target:
            return top(value, round(self.count * (min(run.target, self.count) / self.count) ** done))
        return value > run.settings.lambda_f * RAMP ** (1 - done)

    def state(self) -> dict:
        return {"count": self.count, "psnr": self.psnr}

    def restore(self, state: dict):
        self.count, self.psnr = state["count"], state["psnr"]
