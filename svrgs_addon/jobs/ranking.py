"""The ranking of all source Gaussians by a job: those that it kept come first, then the removed ones, those
removed last before the others.

The job folder gets two arrays from it, (N,) float32 in 0..1:

- score.npy: kept Gaussians are above 0.5, ordered by probability; removed ones are below, ordered by when
  they were removed. In Blender
  it becomes the attribute svrgs:score. The slider of the panel compares it with a threshold and writes the
  attribute `removed`.
- probability.npy, if masks were learned: the last probability p of each Gaussian. In Blender it becomes
  svrgs:probability.
"""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..files.atomic import write_arrays
from ..finetune import scores
from ..finetune.model import MASK
from ..finetune.run import Run
from ..finetune.viewed_scene import ViewedScene
from ..scene.activation import opacities as sigmoid
from ..scene.gaussians import Scene
from ..system.errors import FormatError
from ..views.dataset import Dataset

ALIVE = np.iinfo(np.int32).max  # value of Ranking.dropped for Gaussians that are still in the model
VIEWS = 32  # views for the order of Gaussians for which no mask was learned


class Ranking:
    """Records when a run removes each Gaussian. Rows are those of the source.

    It is written to `file` whenever Gaussians are removed, so that a resumed run has the whole record.
    dropped (N,) int32: the iteration after which a Gaussian was removed, 0: before the first one; ALIVE: not
    removed. probability (N,) float32: the last known probability p; NaN if no mask was learned for it.
    """

    def __init__(self, count: int, file: Path):
        self.file = file
        self.dropped = np.zeros(count, np.int32)
        self.probability = np.full(count, np.nan, np.float32)

    def begin(self, run: Run, rows: np.ndarray):
        """Called before the first step. rows: the source row of each Gaussian with which the run started.
        Raises FormatError for a bad file."""
        self._rows = rows.astype(np.int64)
        if run.iteration and self.file.exists():  # otherwise no Gaussian was removed yet
            self._load()
        self.dropped[self._rows[run.model.origin]] = ALIVE
        self._remember(run)

    def observe(self, run: Run):
        """Called after each step."""
        masks_ended = self._logits is not None and not run.model.learns_masks
        if masks_ended or run.model.count != len(self._origin):
            self._record(run)
            write_arrays(self.file, {"dropped": self.dropped, "probability": self.probability})
        self._remember(run)

    def _load(self):
        try:
            with np.load(self.file, allow_pickle=False) as stored:
                dropped, probability = stored["dropped"], stored["probability"]
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise FormatError(
                f"{self.file}: cannot be read ({error}); discard the job and start again"
            ) from None
        if dropped.shape != self.dropped.shape or probability.shape != self.dropped.shape:
            raise FormatError(f"{self.file}: belongs to another splat; discard the job and start again")
        self.dropped, self.probability = dropped.astype(np.int32), probability.astype(np.float32)

    def _record(self, run: Run):
        """Updates `dropped` and `probability` after Gaussians were removed or mask learning ended."""
        before = self._rows[self._origin]
        if self._logits is not None:
            self.probability[before] = sigmoid(self._logits)
        self.dropped[before] = run.iteration
        self.dropped[self._rows[run.model.origin]] = ALIVE

    def _remember(self, run: Run):
        self._origin = run.model.origin
        # a copy, because keep() works in place
        self._logits = run.model.values[MASK].astype(np.float32) if run.model.learns_masks else None

    def scores(self, kept: np.ndarray, importance: np.ndarray, nested: bool = False) -> np.ndarray:
        """The score of each Gaussian, (N,) float32 in 0..1, all different. Kept ones are above 0.5, by
        probability. Removed ones are below, by the time of removal, then by probability.

        kept (N,) bool. importance (N,): the order of Gaussians with equal probability, or without one.
        nested: that of all kept ones.
        """
        self._record_final()
        probability = np.where(kept & nested, 0.0, np.nan_to_num(self.probability, nan=-1.0))
        order = np.lexsort((importance, probability, np.where(kept, ALIVE, self.dropped)))
        score, removed = np.empty(len(kept), np.float32), len(kept) - int(kept.sum())
        score[order[:removed]] = 0.5 * np.arange(removed) / max(1, removed)
        stays = len(kept) - removed
        score[order[removed:]] = 0.5 + 0.5 * np.arange(1, stays + 1) / max(1, stays)
        return score

    def probabilities(self) -> np.ndarray | None:
        """The last known probability p of each Gaussian, (N,) float32; 0 for those removed before masks were
        learned. None without masks."""
        self._record_final()
        return np.nan_to_num(self.probability, nan=0.0) if np.isfinite(self.probability).any() else None

    def _record_final(self):
        """Records the probabilities of a run that ends while it learns masks."""
        if self._logits is not None:
            self.probability[self._rows[self._origin]] = sigmoid(self._logits)


def importance(scene: Scene, dataset: Dataset, background: tuple[float, float, float]) -> np.ndarray:
    """The rank of each Gaussian by its sum of alpha T over some training views, (N,) float32 from 0 (lowest)
    to 1."""
    views = dataset.train_indices[:: max(1, len(dataset.train_indices) // VIEWS)]
    viewed = ViewedScene.of(scene, [dataset.cameras[i] for i in views], background)
    sums, _, _ = scores.contribution(viewed)
    ranks = np.empty(scene.count, np.float32)
    ranks[np.argsort(sums, kind="stable")] = np.linspace(0, 1, scene.count, dtype=np.float32)
    return ranks
