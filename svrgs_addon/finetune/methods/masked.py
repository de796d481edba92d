"""Base class of methods that learn masks: sampled existence logits (MaskGaussian 3, SVR-GS II-A)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from .. import masks
from ..model import MASK, Model
from ..penalties import sigmoid
from ..quality import fewest_within
from ..run_view import Keep, RunView
from ..settings import Phase, Rates
from .base import Method, learning_phase


@dataclass
class Masked(Method):
    """Masks are sampled from the logits and have straight-through gradients. A pruning event samples 10 times
    and removes the Gaussians that appear in no sample. At the end of the phase Gaussians with p > 0.5 stay,
    or as many as the target."""

    learns_masks: bool = True
    supports_max_loss: bool = True

    def deciding(self, iterations: int, prune_every: int) -> list[Phase]:
        rates = Rates(position_first=5e-6, position_steps=iterations)
        return learning_phase(iterations, rates, prune_every)

    def prepare(self, run: RunView, phase: Phase, number: int):
        if not run.model.learns_masks:
            run.model.add_masks(run.plan.mask_init)

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        drawn, slope = masks.draw(run.model, run.plan.seed, run.iteration)
        return {
            "masks": drawn,
            "slope": slope,
            "lambda_f": run.plan.lambda_f * run.strength,
            "lambda_m": run.plan.lambda_m * run.strength,
        }

    def survivors(self, run: RunView) -> Keep:
        return masks.ever_drawn(run.model, run.plan.seed, run.iteration, run.plan.draws)

    def final_mask(self, run: RunView) -> Keep:
        """Without a target, the Gaussians with p > 0.5 stay. With a target, exactly so many of the most
        probable ones; with an allowed drop, the fewest most probable ones that hold it."""
        if run.plan.max_loss:
            return fewest_within(run, run.model.values[MASK], run.quality_before - run.plan.max_loss)
        if run.target:
            return masks.most_probable(run.model, run.target, run.own)
        return self.current_mask(run.model)

    def current_mask(self, model: Model) -> Keep:
        return masks.most_probable(model)

    def expected_count(self, logits: np.ndarray) -> float:
        """The sum of all probabilities p."""
        return float(sigmoid(logits, np).sum(dtype=np.float64))
