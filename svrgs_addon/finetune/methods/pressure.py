"""SVR-GS as it prunes best here (docs/methods.md): lambda_F says how many Gaussians stay, a pressure on all opacities says which.

How many: as many as are worth more than lambda_F to the objective when pruning starts (worth.py), or the target. Which: those whose
gradient withstands the pressure of GNS on opacity logits, the rest fading while the others take over; what would be missed least
(the cost of worth.py) is pressed hardest, and the pressure takes the whole phase. From few photographs all are pressed alike: what
these would miss is not what other views would. In the recovery some Gaussians are absent from each step, as masks had it: the more,
the fewer photographs there are to lean on.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from .. import masks
from ..saliency import costs, worth
from ..settings import Densify, Phase, Settings
from .gns import GNS

if TYPE_CHECKING:
    from ..loop import Run

LOOK_EVERY = 16  # pushes between two looks at the costs
POWER, LARGEST = 0.5, 100.0  # a share is (cost at the budget's rank / cost)^POWER, within 1/LARGEST and LARGEST
FEW = 32  # training views: with fewer, costs say nothing
ABSENT = 6.0  # of as many training views; settings.Phase.absent
SHARES = "pressure_shares"  # of the model's values: moves with the rows, is stored with them, is not learned


@dataclass
class Selection(GNS):
    lambda_f: float = 1e-4
    share: float = 0.0
    goal_zero: float = 1.0
    least_between: int = 4
    drop_held_by: str = "svr-worth"  # a budget must be known when pressure begins

    def train_phases(self, iterations: int, recovery: int, densify: Densify, coarse_until: int) -> list[Phase]:
        return _with_absence(super().train_phases(iterations, recovery, densify, coarse_until))

    def prune_phases(self, iterations: int, recovery: int, prune_every: int) -> list[Phase]:
        return _with_absence(super().prune_phases(iterations, recovery, prune_every))

    def weighs(self, settings: Settings) -> bool:
        return not (settings.target or settings.share or settings.max_drop)

    def terms(self, run: Run, phase: Phase, number: int) -> dict:
        if not run.target:
            stays = worth(run.model, run.training_cameras, run.engine.rasterizer, run.score_options) > run.settings.lambda_f
            masks.refuse_emptying(stays, run.initial_count)
            run.target = int(stays.sum())
        return super().terms(run, phase, number)

    def shares(self, run: Run, phase: Phase, number: int) -> np.ndarray | None:
        model = run.model
        if len(run.training_cameras) < FEW:
            return None
        if SHARES not in model.values or (number - 1) % (LOOK_EVERY * self.push_every(phase)) == 0:
            cost = costs(model, run.training_cameras, run.engine.rasterizer, run.score_options)
            model.add(SHARES, pressure_shares(cost, run.target).astype(model.dtype))
        return model.values[SHARES]


def pressure_shares(cost: np.ndarray, budget: int) -> np.ndarray:
    """(N,) float64, 1 on average: the less a Gaussian would be missed, the more."""
    cost = np.maximum(cost, 1e-30)
    at_budget = np.partition(cost, max(len(cost) - budget, 0))[max(len(cost) - budget, 0)]
    shares = np.clip((at_budget / cost) ** POWER, 1 / LARGEST, LARGEST)
    return shares / shares.mean()


def _with_absence(phases: list[Phase]) -> list[Phase]:
    return [replace(phase, absent=ABSENT) if phase.name == "recover" else phase for phase in phases]
