"""POPSpa (KISS-GS, arXiv 2608.26948): a cut by Delta SE (../saliency.py), ADMM on the opacities together with
a term for round shapes, a second cut, recovery. ADMM pulls the opacities of all but the Gaussians of highest
Delta SE, as many as the target, to 0.

ADMM (GaussianSpa, arXiv 2411.06019) has a proxy z that is 0 for the Gaussians that are to go, and a dual
variable u. The loss gets rho/2 |o - (z - u)|^2. The dual u and the goal z - u are among the model's values,
so that rows move with them and checkpoints hold them. They are not learned.
"""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from ..model import Model
from ..penalties import EffectiveRank, OpacityGoal, sigmoid
from ..run_view import RunView
from ..saliency import removal_errors
from ..settings import Phase, Settings
from .stepwise import Stepwise

RHO = 5e-4
PULL_EVERY = 50 / 5_000  # share of the steps from one in which ADMM pulls, then projects, to the next
MIN_PULL_STEPS = 10  # the same, at least
DUAL, GOAL = "admm_dual", "admm_goal"  # names of the values u and z - u


@dataclass
class POPSpa(Stepwise):
    EVENTS: ClassVar = (0.0, 1.0)
    share: float = 0.2

    def prepare(self, run: RunView, phase: Phase, number: int):
        if self.count and (self._pulls(phase, number - 1) or GOAL not in run.model.values):
            project(run.model, self.highest(run, run.target))

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        if not self.count:
            return {}
        shape = EffectiveRank(thin=EffectiveRank.thin / run.viewed.cameras[0].unit)
        pull = (OpacityGoal(RHO, run.model.values[GOAL]),) if self._pulls(phase, number) else ()
        return {"penalties": (shape, *pull)}

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        first, last = super().ranking_passes(settings, steps, share)
        pulls = steps // pull_every(steps)
        return [first, *((k / pulls, first[1]) for k in range(pulls)), last]

    def _pulls(self, phase: Phase, number: int) -> bool:
        return number % pull_every(phase.steps - self.begun(phase)) == 0


def project(model: Model, stays: np.ndarray):
    """z becomes o + u for Gaussians of `stays` (N,) bool, else 0; then u, at first 0, grows by o - z."""
    o, begun = sigmoid(model.opacity_logits, np), GOAL in model.values
    u = model.values[DUAL] if begun else np.zeros_like(o)
    z = np.where(stays, o + u, 0).astype(o.dtype)
    u = u + o - z if begun else u
    model.add(DUAL, u)
    model.add(GOAL, z - u)


def pull_every(steps: int) -> int:
    """The number of steps from one pull to the next."""
    return max(MIN_PULL_STEPS, round(PULL_EVERY * steps))


METHODS = (
    POPSpa(
        "popspa",
        "cuts twice by the change of the photographs and fades, in between, the Gaussians that are to go",
        21,
        "POPSpa",
        source="POPSpa in KISS-GS, arXiv 2608.26948",
        ranking=removal_errors,
    ),
)
