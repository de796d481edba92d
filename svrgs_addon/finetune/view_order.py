"""The order of the training views."""

from __future__ import annotations

import numpy as np

LEFT_OUT = 0.25  # share of the views that an epoch leaves out, if views are chosen by loss
RECENT = 0.5  # weight of the newest loss in the smoothed loss of a view


class ViewOrder:
    """The order of the training views. Each epoch has its own permutation, keyed by (seed, epoch).

    by_loss: an epoch leaves out a quarter of the views: those of lowest smoothed loss among the ones that the
    epoch before showed. So the half of the views with the lower loss is shown in every other epoch. The
    choice is made when an epoch begins, from losses alone.
    """

    def __init__(self, indices: list[int], seed: int, by_loss: bool = False):
        self.indices, self.seed, self.by_loss = np.array(indices, np.int64), seed, by_loss
        self.places = {view: k for k, view in enumerate(indices)}
        self.epoch, self.position = 0, 0  # position: number of views of the epoch that were shown
        self.losses = np.full(len(indices), np.nan)  # smoothed loss of each view; NaN: never shown
        self.left_out = np.zeros(len(indices), bool)  # views that this epoch leaves out

    def rest(self) -> list[int]:
        """The views that this epoch has yet to show, in order."""
        order = np.random.default_rng([self.seed, self.epoch]).permutation(len(self.indices))
        return self.indices[order[~self.left_out[order]]][self.position :].tolist()

    def shown(self, view: int, loss: float):
        """Records that `view`, the first of rest(), was shown, and its image loss."""
        k = self.places[view]
        before = self.losses[k]
        self.losses[k] = loss if np.isnan(before) else before + RECENT * (loss - before)
        self.position += 1
        if self.position == len(self.indices) - self.left_out.sum():
            self.epoch, self.position = self.epoch + 1, 0
            self.left_out = self._easiest() if self.by_loss else self.left_out

    def _easiest(self) -> np.ndarray:
        """(n,) bool: the views that the next epoch leaves out."""
        losses = np.where(self.left_out, np.inf, self.losses)  # a view is never left out twice in a row
        easiest = np.zeros(len(losses), bool)
        easiest[np.argsort(losses, kind="stable")[: int(len(losses) * LEFT_OUT)]] = True
        return easiest
