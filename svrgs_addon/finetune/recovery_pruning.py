"""What the recovery wins back is spent where a loss of quality is allowed: a few times in it, what is worth least goes (worth.py).

Each time as many go as bring the drop to the one allowed by the next time, if the steps until then win back that share of what the
cut costs which they won back of the last cut.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from .saliency import worth
from .strength_controller import fewest_within, psnr_of

if TYPE_CHECKING:
    from .loop import Run
    from .methods.base import Keep
    from .settings import Phase

CUTS = (0.25, 0.5, 0.75, 0.9)  # of a recovery
WON_BACK, LESS = 0.65, 0.93  # share won back of the first cut, and at most; less of each than of the one before
DEEPEST = 1.5  # dB below what is allowed that are left to be won back


@dataclass
class Closing:
    """State: PSNR over a few training views (psnr_of) before the first step, before the last cut, and after it."""

    start: float = 0.0
    before_cut: float = 0.0
    after_cut: float = 0.0

    def before(self, run: Run):
        """Called before each step: notes where the run starts from."""
        if not self.start:
            self.start = psnr_of(run, None)

    def cut(self, run: Run, phase: Phase, number: int) -> Keep:
        """After step `number` of the recovery."""
        if number not in [round(share * phase.steps) for share in CUTS]:
            return None
        now = psnr_of(run, None)
        spare = now - (self.start - run.settings.max_drop)
        if spare <= 0:
            return None
        ranking = worth(run.model, run.training_cameras, run.engine.rasterizer, run.score_options)
        share = self.won_back(now)
        kept = fewest_within(run, ranking, now - spare - min(spare * share / (1 - share), DEEPEST))
        self.before_cut, self.after_cut = now, psnr_of(run, kept)
        return kept

    def won_back(self, now: float) -> float:
        """The share of the next cut's cost that will be won back."""
        cost = self.before_cut - self.after_cut
        return min(max(LESS * (now - self.after_cut) / cost, 0.0), WON_BACK) if cost > 0 else WON_BACK

    def drop(self, run: Run) -> float:
        """dB lost so far."""
        return self.start - psnr_of(run, None)
