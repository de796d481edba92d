"""POPSpa (KISS-GS, arXiv 2608.26948): a cut by Delta SE (../saliency.py), ADMM on the opacities (../admm.py)
together with a term for round shapes, a second cut, recovery. ADMM pulls the opacities of all but the
Gaussians of highest Delta SE, as many as the target, to 0."""

from dataclasses import dataclass
from typing import ClassVar

from .. import admm
from ..penalties import EffectiveRank
from ..run_view import RunView
from ..saliency import removal_errors
from ..settings import Phase, Settings
from .stepwise import Stepwise

RHO = 5e-4
PULL_EVERY = 50 / 5_000  # share of the steps from one in which ADMM pulls, then projects, to the next
MIN_PULL_STEPS = 10  # the same, at least


@dataclass
class POPSpa(Stepwise):
    EVENTS: ClassVar = (0.0, 1.0)
    share: float = 0.2

    def prepare(self, run: RunView, phase: Phase, number: int):
        if self.count and (self._pulls(phase, number - 1) or not admm.begun(run.model)):
            admm.project(run.model, self.highest(run, run.target))

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        pull = (admm.pull(run.model, RHO),) if self.count and self._pulls(phase, number) else ()
        return {"penalties": (EffectiveRank(), *pull)} if self.count else {}

    def ranking_passes(self, settings: Settings, steps: int, share: float) -> list[tuple[float, float]]:
        first, last = super().ranking_passes(settings, steps, share)
        pulls = steps // pull_every(steps)
        return [first, *((k / pulls, first[1]) for k in range(pulls)), last]

    def _pulls(self, phase: Phase, number: int) -> bool:
        return number % pull_every(phase.steps - self.begun(phase)) == 0


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
