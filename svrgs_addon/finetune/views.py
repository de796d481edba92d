"""Which photograph each step looks at, and at what size."""

from __future__ import annotations

import numpy as np

LEFT_OUT = 0.25  # share of the views that an epoch leaves out, where they are chosen by loss
RECENT = 0.5  # weight of a view's newest loss in its smoothed one
MIN_SIDE = 16  # pixels; no photograph is reduced below


class Views:
    """The order of the training views: each epoch is a permutation of its own, keyed by (seed, epoch).

    by_loss: an epoch leaves out the quarter of the views with the lowest smoothed loss, of those the epoch before showed;
    so the easier half of them is shown every other time. An epoch is planned where it begins, from losses alone.
    """

    def __init__(self, indices: list[int], seed: int, by_loss: bool = False):
        self.indices, self.seed, self.by_loss = np.array(indices, np.int64), seed, by_loss
        self.places = {view: k for k, view in enumerate(indices)}
        self.epoch, self.position = 0, 0  # and how many views of it were shown
        self.losses = np.full(len(indices), np.nan)  # smoothed, by view; NaN: never shown
        self.left_out = np.zeros(len(indices), bool)  # of this epoch

    def rest(self) -> list[int]:
        """The views this epoch has still to show, in order."""
        order = np.random.default_rng([self.seed, self.epoch]).permutation(len(self.indices))
        return self.indices[order[~self.left_out[order]]][self.position :].tolist()

    def shown(self, view: int, loss: float):
        """Notes that `view`, the first of rest(), was shown, and its loss of colours."""
        k = self.places[view]
        self.losses[k] = loss if np.isnan(self.losses[k]) else self.losses[k] + RECENT * (loss - self.losses[k])
        self.position += 1
        if self.position == len(self.indices) - self.left_out.sum():
            self.epoch, self.position = self.epoch + 1, 0
            self.left_out = self._easiest() if self.by_loss else self.left_out

    def _easiest(self) -> np.ndarray:
        """(n,) bool: what the next epoch leaves out."""
        losses = np.where(self.left_out, np.inf, self.losses)  # never twice in a row
        easiest = np.zeros(len(losses), bool)
        easiest[np.argsort(losses, kind="stable")[: int(len(losses) * LEFT_OUT)]] = True
        return easiest


def fitting_reduction(factor: int, width: int, height: int) -> int:
    """`factor`, halved until the shorter side keeps MIN_SIDE pixels."""
    while factor > 1 and min(width, height) < factor * MIN_SIDE:
        factor //= 2
    return factor


def as_real(image: np.ndarray, dtype, factor: int = 1) -> np.ndarray:
    """A photograph as the loss wants it: (H // factor, W // factor, 3), 0..1 of the given dtype, in display space.

    Each pixel is the mean of factor x factor of the photograph's (see Camera.reduced).
    """
    scale = dtype.type((1 / 255 if image.dtype == np.uint8 else 1.0) / factor**2)
    if factor == 1:
        return np.ascontiguousarray(image, dtype) if scale == 1 else np.multiply(image, scale, dtype=dtype)
    height, width = image.shape[0] // factor, image.shape[1] // factor
    rows = sum_of(np.uint16 if image.dtype == np.uint8 else dtype, [image[k : height * factor : factor] for k in range(factor)])
    reduced = np.empty((height, width, 3), dtype)
    for channel in range(3):  # one at a time, NumPy walks along the rows and not from channel to channel: 2 to 9 times as fast
        columns = [rows[:, k : width * factor : factor, channel] for k in range(factor)]
        np.multiply(sum_of(rows.dtype, columns), scale, out=reduced[:, :, channel])
    return reduced


def sum_of(dtype, parts: list[np.ndarray]) -> np.ndarray:
    total = parts[0].astype(dtype)
    for part in parts[1:]:
        total += part
    return total
