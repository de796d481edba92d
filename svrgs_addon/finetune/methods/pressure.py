"""The default: opacity pressure weighted by removal error, with a budget from lambda_F or the target (docs/methods.md).

Budget: the number of Gaussians with a saliency above lambda_F, or the target. Selection: GNS's pressure on all opacity logits, over the
whole phase. The pressure on a Gaussian is proportional to (removal error at the budget / its removal error)^1/2, within [0.01, 100].
With few training views all are pressed alike: their removal errors say little about other views. Recovery uses dropout: the fewer the
training views, the more.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace

import numpy as np

from .. import masks
from ..saliency import removal_errors, saliency
from ..settings import Densify, Phase, Settings
from .base import RunView
from .opacity_pressure import Pressed

UPDATE_EVERY = 16  # pressed steps between two updates of the shares
POWER, LARGEST = 0.5, 100.0
FEW = 32  # training views: with fewer, all are pressed alike
DROPOUT = 6.0  # times 1 / training views: settings.Phase.dropout
SHARES = "pressure_shares"  # of the model's values: it moves with the rows and is stored with them, but is not learned


@dataclass
class Pressure(Pressed):
    lambda_f: float = 1e-4
    lambda_f_help: str = field(default="how much a Gaussian must be worth to stay: its removal error over its part in the spatial mask", repr=False)
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
        due = self._presses(phase, number) and (SHARES not in run.model.values or (number - 1) % (UPDATE_EVERY * self.press_every(phase)) == 0)
        if due and len(run.training_cameras) >= FEW:
            errors = removal_errors(run.model, run.training_cameras, run.rasterizer, run.score_options)
            run.model.add(SHARES, pressure_shares(errors, run.target).astype(run.model.dtype))

    def shares(self, run: RunView) -> np.ndarray | None:
        return run.model.values.get(SHARES)


def pressure_shares(errors: np.ndarray, budget: int) -> np.ndarray:
    """(N,) float64, 1 on average: the share of each Gaussian in the pressure, from its removal error (N,)."""
    errors = np.maximum(errors, 1e-30)
    place = max(len(errors) - budget, 0)
    shares = np.clip((np.partition(errors, place)[place] / errors) ** POWER, 1 / LARGEST, LARGEST)
    return shares / shares.mean()


def _with_dropout(phases: list[Phase]) -> list[Phase]:
    return [replace(phase, dropout=DROPOUT) if phase.name == "recover" else phase for phase in phases]


METHODS = (Pressure("pressure", "presses down the opacities of the Gaussians whose removal costs least, until the budget is reached", 0, "Recommended"),)
