"""What methods share that learn one existence logit a Gaussian, drawn anew each step (MaskGaussian section 3, SVR-GS section II-A)."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from .. import masks
from ..model import MASK, Model
from ..penalties import sigmoid
from ..settings import Phase, Rates, Settings
from ..strength_controller import fewest_within
from .base import Keep, Method

if TYPE_CHECKING:
    from ..loop import Run

SETTLED_EVERY = 50  # steps between two looks for masks that have settled


@dataclass
class Masked(Method):
    """Masks drawn from the logits, straight-through gradients, events of 10 draws, and p > 0.5 (or the target) at the end."""

    learns_masks: bool = True
    holds_drop: bool = True
    first_cut: bool = True

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        learn = Phase("prune", iterations, Rates(position_first=5e-6, position_steps=iterations), active=True, prune_every=prune_every)
        return [*([learn] if iterations else []), *super().prune_phases(iterations, recovery, prune_every)]

    def enter(self, model: Model, settings: Settings):
        if not model.learns_masks:
            model.add_masks(settings.mask_init)

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        drawn, slope = masks.draw(run.model, run.settings.seed, run.iteration)
        return {"masks": drawn, "slope": slope, "lambda_f": run.settings.lambda_f * run.strength, "lambda_m": run.settings.lambda_m * run.strength}

    def survivors(self, run: Run) -> Keep:
        return masks.ever_drawn(run.model, run.settings.seed, run.iteration, run.settings.draws)

    def after_step(self, run: Run, phase: Phase, number: int) -> Keep:
        keep = super().after_step(run, phase, number)
        if keep is None and run.settings.drop_settled and number % SETTLED_EVERY == 0:
            return ~masks.settled(run.model)
        return keep

    def decided(self, run: Run) -> Keep:
        """p > 0.5, or else exactly what was asked for, the most probable first."""
        if run.settings.max_drop:
            return fewest_within(run, run.model.values[MASK], run.control.start - run.settings.max_drop)
        return masks.decided(run.model, run.target) if run.target else self.existing(run.model)

    def existing(self, model: Model) -> Keep:
        return masks.decided(model)

    def expected(self, model: Model) -> float:
        """The sum of all p."""
        return float(sigmoid(model.values[MASK], np).sum(dtype=np.float64))
