"""Pruning during the recovery, when a loss of quality is allowed (--max-drop, --max-flip, --max-lpips;
docs/methods.md, "Holding a loss of quality").

The recovery wins back quality, so more Gaussians can be removed. At the shares CUTS of the recovery, the
Gaussians of lowest removal error are removed. A cut removes so many that the loss is expected to equal the
allowed one at the next cut. The expectation: the steps up to the next cut win back the same share of this
cut's loss as they did for the last cut.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..render.metrics.allowed_loss import MEASURES
from ..system.errors import SceneError
from .quality import fewest_within
from .run_view import Keep, RunView
from .saliency import removal_errors
from .settings import Phase

CUTS = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7, 0.8)  # shares of the recovery's steps
# share of a cut's loss that is won back: assumed for the first cut, at most for later ones; factor per cut
RECOVERED, DECAY = 0.75, 0.93


@dataclass
class RecoveryPruning:
    """Decides the cuts. Its state is the quality on a few views (RunView.quality): before the run and its
    first cut, before the last cut, after the last cut."""

    start: float = 0.0
    before_cut: float = 0.0
    after_cut: float = 0.0

    def before_step(self, run: RunView):
        """Before the first step of the run it measures the quality, unless that of the scene before a first
        cut is known. Raises SceneError if a scene without Gaussians holds the allowed loss."""
        if run.iteration:
            return
        self.start, nobody = self.start or run.quality(None), np.zeros(run.model.count, bool)
        if run.quality(nobody) >= self.start - run.plan.max_loss:
            allowed = f"{run.plan.max_loss:g} {MEASURES[run.plan.measure].unit} allowed"
            raise SceneError(
                f"pruning would leave no Gaussian: even an empty scene loses less than the {allowed}; allow"
                " less, and check that the photographs are not black and show this scene"
            )

    def cut(self, run: RunView, phase: Phase, number: int) -> Keep:
        """(N,) bool: the Gaussians that stay after step `number` of the recovery. None: all, because no cut
        is due or nothing is to spare."""
        if number not in [round(share * phase.steps) for share in CUTS]:
            return None
        now = run.quality(None)
        spare = now - (self.start - run.plan.max_loss)
        if spare <= 0:
            return None
        ranking = removal_errors(run.viewed)
        share = self.recovered_share(now)
        kept = fewest_within(
            run, ranking, now - spare - min(spare * share / (1 - share), MEASURES[run.plan.measure].deepest)
        )
        self.before_cut, self.after_cut = now, run.quality(kept)
        return kept

    def recovered_share(self, now: float) -> float:
        """The share of the next cut's loss that the recovery is expected to win back."""
        loss = self.before_cut - self.after_cut
        return min(max(DECAY * (now - self.after_cut) / loss, 0.0), RECOVERED) if loss > 0 else RECOVERED
