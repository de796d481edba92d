"""The order of the training views, and photographs at the size and type that the loss needs."""

from __future__ import annotations

import numpy as np

from ..scene.camera import Camera

LEFT_OUT = 0.25  # share of the views that an epoch leaves out, if views are chosen by loss
RECENT = 0.5  # weight of the newest loss in the smoothed loss of a view
MIN_SIDE = 16  # pixels: no photograph is reduced to a shorter side


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


def fitting_reduction(factor: int, width: int, height: int) -> int:
    """`factor`, halved until the reduced shorter side has at least MIN_SIDE pixels; at least 1."""
    while factor > 1 and min(width, height) < factor * MIN_SIDE:
        factor //= 2
    return factor


def as_real(image: np.ndarray, dtype, factor: int = 1) -> np.ndarray:
    """A photograph for the loss: (H // factor, W // factor, 3) of the given dtype, display sRGB in 0..1.

    Each pixel is the mean of factor x factor pixels of the photograph (see Camera.reduced).
    """
    scale = dtype.type((1 / 255 if image.dtype == np.uint8 else 1.0) / factor**2)
    if factor == 1:
        return np.ascontiguousarray(image, dtype) if scale == 1 else np.multiply(image, scale, dtype=dtype)
    height, width = image.shape[0] // factor, image.shape[1] // factor
    sums = np.uint16 if image.dtype == np.uint8 else dtype
    rows = sum_of(sums, [image[k : height * factor : factor] for k in range(factor)])
    reduced = np.empty((height, width, 3), dtype)
    # one channel at a time, so that NumPy's inner loop runs along rows: 2 to 9 times as fast
    for channel in range(3):
        columns = [rows[:, k : width * factor : factor, channel] for k in range(factor)]
        np.multiply(sum_of(rows.dtype, columns), scale, out=reduced[:, :, channel])
    return reduced


def photo_of(camera: Camera, image: np.ndarray, dtype, factor: int) -> np.ndarray:
    """as_real() of the photograph of a view; 0 where pixels do not count, also where a part of them does not.
    camera: reduced by the factor."""
    photo, valid = as_real(image, dtype, factor), camera.valid if factor > 1 else None
    if valid is not None:
        photo *= valid[..., None]
    return photo


def sum_of(dtype, parts: list[np.ndarray]) -> np.ndarray:
    """The sum of arrays of one shape, of the given dtype."""
    total = parts[0].astype(dtype)
    for part in parts[1:]:
        total += part
    return total
