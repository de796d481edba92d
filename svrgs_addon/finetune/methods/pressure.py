"""The default method: opacity pressure weighted by removal error (docs/methods.md, "`pressure`, the default").

Budget: the target, or the number of Gaussians with a saliency above lambda_F. Pressure: that of GNS on all opacity logits, over the
whole phase. The pressure on a Gaussian is proportional to (removal error at the budget / its removal error)^1/2, clipped to
[0.01, 100]. With fewer than FEW training views the pressure is the same for all Gaussians, because removal errors on few photographs
say little about other views. The recovery uses dropout, with a rate proportional to 1 / training views.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .. import masks
from ..saliency import removal_errors, saliency
from ..settings import Densify, Phase, Settings
from .base import RunView
from .opacity_pressure import PressureMethod

UPDATE_EVERY = 16  # pressed steps between two measurements of the removal errors
POWER, LARGEST = 0.5, 100.0  # exponent of the weights; they are clipped to [1 / LARGEST, LARGEST]
FEW = 32  # training views: with fewer, all weights are 1
DROPOUT = 6.0  # dropout rate times training views (settings.Phase.dropout)
WEIGHTS = "pressure_weights"  # name among the model's values, so that rows move with it and checkpoints hold it; it is not learned


@dataclass
class Pressure(PressureMethod):
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default="the saliency above which a Gaussian stays", repr=False)
    goal_zero: float = 1.0
    least_between: int = 4
    max_drop_method: str = "saliency"  # a budget must be known when the pressure starts

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        return _with_dropout(super().train_phases(iterations, recovery, densify, coarse_until))

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        return _with_dropout(super().prune_phases(iterations, recovery, prune_every))

    def uses_lambda_f(self, settings: Settings) -> bool:
        return not (settings.target or settings.share or settings.max_drop)

    def budget(self, run: RunView) -> int:
        stays = saliency(run.model, run.training_cameras, run.rasterizer, run.score_options) > run.settings.lambda_f
        masks.refuse_emptying(stays, run.initial_count)
        return int(stays.sum())

    def prepare(self, run: RunView, phase: Phase, number: int):
        super().prepare(run, phase, number)
        due = self._presses(phase, number) and (WEIGHTS not in run.model.values or (number - 1) % (UPDATE_EVERY * self.press_every(phase)) == 0)
        if due and len(run.training_cameras) >= FEW:
            errors = removal_errors(run.model, run.training_cameras, run.rasterizer, run.score_options)
            run.model.add(WEIGHTS, pressure_weights(errors, run.target).astype(run.model.dtype))

    def gaussian_weights(self, run: RunView) -> np.ndarray | None:
        return run.model.values.get(WEIGHTS)


def pressure_weights(errors: np.ndarray, budget: int) -> np.ndarray:
    """The weight of each Gaussian in the pressure, (N,) float64, 1 on average, from the removal errors (N,)."""
    errors = np.maximum(errors, 1e-30)
    place = max(len(errors) - budget, 0)
    weights = np.clip((np.partition(errors, place)[place] / errors) ** POWER, 1 / LARGEST, LARGEST)
    return weights / weights.mean()


def _with_dropout(phases: list[Phase]) -> list[Phase]:
    return [replace(phase, dropout=DROPOUT) if phase.name == "recover" else phase for phase in phases]


METHODS = (Pressure("pressure", "fades out and removes the Gaussians that the photographs need least", 0, "Recommended"),)
