"""The order in which a job let go of its source's Gaussians: what it kept comes first, what it dropped last next."""

from __future__ import annotations

from pathlib import Path
from zipfile import BadZipFile

import numpy as np

from ..blender.activation import opacities as sigmoid
from ..errors import FormatError
from ..files.npz import write_arrays
from ..finetune import scores
from ..finetune.model import MASK
from ..finetune.run import Run
from ..scene import Scene

ALIVE = np.iinfo(np.int32).max
VIEWS = 32  # looked at for the order of what no mask ever judged


class Ranking:
    """Watches a run; rows are those of the source. Stored whenever Gaussians go, so that a resumed run knows of all before it.

    dropped (N,) int32: the iteration after which a Gaussian was gone, 0: before the first; ALIVE. probability (N,) float32: of
    its existence, when last known; NaN where no mask was learned for it.
    """

    def __init__(self, count: int, file: Path):
        self.file = file
        self.dropped = np.zeros(count, np.int32)
        self.probability = np.full(count, np.nan, np.float32)

    def begin(self, run: Run, rows: np.ndarray):
        """rows: the source's row of each Gaussian that the run began with."""
        self._rows = rows.astype(np.int64)
        if run.iteration and self.file.exists():  # else none has gone yet
            self._load()
        self.dropped[self._rows[run.model.origin]] = ALIVE
        self._remember(run)

    def observe(self, run: Run):
        """To be called after each step."""
        judged = self._logits is not None and not run.model.learns_masks
        if judged or run.model.count != len(self._origin):
            self._write_down(run)
            write_arrays(self.file, {"dropped": self.dropped, "probability": self.probability})
        self._remember(run)

    def _load(self):
        try:
            with np.load(self.file, allow_pickle=False) as stored:
                dropped, probability = stored["dropped"], stored["probability"]
        except (OSError, ValueError, KeyError, EOFError, BadZipFile) as error:
            raise FormatError(f"{self.file}: cannot be read ({error}); discard the job and start anew") from None
        if dropped.shape != self.dropped.shape or probability.shape != self.dropped.shape:
            raise FormatError(f"{self.file}: is of another splat; discard the job and start anew")
        self.dropped, self.probability = dropped.astype(np.int32), probability.astype(np.float32)

    def _write_down(self, run: Run):
        before = self._rows[self._origin]
        if self._logits is not None:
            self.probability[before] = sigmoid(self._logits)
        self.dropped[before] = run.iteration
        self.dropped[self._rows[run.model.origin]] = ALIVE

    def _remember(self, run: Run):
        self._origin = run.model.origin
        self._logits = run.model.values[MASK].astype(np.float32) if run.model.learns_masks else None  # a copy: keep() moves rows in place

    def scores(self, kept: np.ndarray, importance: np.ndarray) -> np.ndarray:
        """(N,) float32 in 0..1, all different: above 0.5 what was kept, by probability; below what was dropped, by when, then by probability.

        kept (N,) bool; importance (N,) decides between those of one probability, and where none was learned.
        """
        self._judge_last()
        order = np.lexsort((importance, np.nan_to_num(self.probability, nan=-1.0), np.where(kept, ALIVE, self.dropped)))
        score, gone = np.empty(len(kept), np.float32), len(kept) - int(kept.sum())
        score[order[:gone]] = 0.5 * np.arange(gone) / max(1, gone)
        score[order[gone:]] = 0.5 + 0.5 * np.arange(1, len(kept) - gone + 1) / max(1, len(kept) - gone)
        return score

    def probabilities(self) -> np.ndarray | None:
        """(N,) float32 in 0..1, of existence when last known; 0 for what went before masks were learned. None where none were."""
        self._judge_last()
        return np.nan_to_num(self.probability, nan=0.0) if np.isfinite(self.probability).any() else None

    def _judge_last(self):
        """Of a run that ended with its masks."""
        if self._logits is not None:
            self.probability[self._rows[self._origin]] = sigmoid(self._logits)


def importance(scene: Scene, dataset, rasterizer, options) -> np.ndarray:
    """(N,) float32 in 0..1: rank of each Gaussian by its sum of alpha T over some training views."""
    views = dataset.train_indices[:: max(1, len(dataset.train_indices) // VIEWS)]
    sums, _, _ = scores.contribution(scene, [dataset.cameras[i] for i in views], rasterizer, options)
    ranks = np.empty(scene.count, np.float32)
    ranks[np.argsort(sums, kind="stable")] = np.linspace(0, 1, scene.count, dtype=np.float32)
    return ranks
