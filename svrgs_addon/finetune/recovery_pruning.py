"""Pruning during recovery, where a drop in PSNR is allowed: recovery wins back quality, and more Gaussians can go for it.

At CUTS of the recovery, the Gaussians with the lowest saliency are removed. Each cut removes as many as bring the drop to the
allowed one by the next cut. It assumes that the steps in between recover the same share of this cut's loss as they did of the last.
"""

from __future__ import annotations

from dataclasses import dataclass

from .quality import fewest_within
from .run_view import Keep, RunView
from .saliency import saliency
from .settings import Phase

CUTS = (0.25, 0.5, 0.75, 0.9)  # of a recovery
RECOVERED, DECAY = 0.65, 0.93  # share recovered of the first cut's loss, and the largest; factor on it from cut to cut
DEEPEST = 1.5  # dB below the allowed PSNR that a cut may leave for the recovery


@dataclass
class RecoveryPruning:
    """State: PSNR on a few training views (RunView.psnr) before the first step, before the last cut, and after it."""

    start: float = 0.0
    before_cut: float = 0.0
    after_cut: float = 0.0

    def before_step(self, run: RunView):
        """Notes the PSNR that the run starts from."""
        if not self.start:
            self.start = run.psnr(None)

    def cut(self, run: RunView, phase: Phase, number: int) -> Keep:
        """The Gaussians that stay after step `number` of the recovery."""
        if number not in [round(share * phase.steps) for share in CUTS]:
            return None
        now = run.psnr(None)
        spare = now - (self.start - run.settings.max_drop)
        if spare <= 0:
            return None
        ranking = saliency(run.model, run.training_cameras, run.rasterizer, run.score_options)
        share = self.recovered_share(now)
        kept = fewest_within(run, ranking, now - spare - min(spare * share / (1 - share), DEEPEST))
        self.before_cut, self.after_cut = now, run.psnr(kept)
        return kept

    def recovered_share(self, now: float) -> float:
        """The share of the next cut's loss that the recovery is expected to win back."""
        cost = self.before_cut - self.after_cut
        return min(max(DECAY * (now - self.after_cut) / cost, 0.0), RECOVERED) if cost > 0 else RECOVERED

    def drop(self, run: RunView) -> float:
        """dB lost since the first step."""
        return self.start - run.psnr(None)
