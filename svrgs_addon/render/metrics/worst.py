"""Where a pruned scene differs most from the original, by FLIP: the worst view and its worst square."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from .measures import flip_map

SIDE = 96  # pixels of the square, at most
VIEWS = 16  # among which the worst one is looked for, at most
LARGEST = 800  # pixels: larger pictures are reduced to about that on their longer side


@dataclass(frozen=True)
class Worst:
    """A view and its worst square."""

    view: str
    flip: float  # mean over the view
    square: tuple[int, int, int, int]  # x, y, width, height in pixels of the pictures that were compared
    square_flip: float  # mean over the square
    original: np.ndarray  # (h, w, 3) in 0..1: what the original shows in the square
    picture: np.ndarray  # and the pruned scene

    def facts(self) -> dict:
        """The keys of the JSON result."""
        return {
            "view": self.view,
            "flip": self.flip,
            "square": list(self.square),
            "square_flip": self.square_flip,
        }


def worst_of(pairs: Iterable[tuple[str, np.ndarray, np.ndarray]]) -> Worst | None:
    """The worst of some views; None without any. pairs: names of the views, and the pictures (H, W, 3) in
    0..1 of the original and of the pruned scene."""
    found = None
    for view, original, picture in pairs:
        flips = flip_map(original, picture)
        mean = float(flips.mean(dtype=np.float64))
        if found is None or mean > found.flip:
            (x, y, width, height), worst = worst_square(flips)
            part = slice(y, y + height), slice(x, x + width)
            found = Worst(view, mean, (x, y, width, height), worst, original[part], picture[part])
    return found


def worst_square(values: np.ndarray) -> tuple[tuple[int, int, int, int], float]:
    """(x, y, width, height) of the square, up to SIDE, of the highest mean, and it. values: (H, W)."""
    height, width = (min(SIDE, size) for size in values.shape)
    sums = np.zeros((values.shape[0] + 1, values.shape[1] + 1))
    np.cumsum(np.cumsum(values, axis=0, dtype=np.float64), axis=1, out=sums[1:, 1:])
    means = sums[height:, width:] - sums[:-height, width:] - sums[height:, :-width] + sums[:-height, :-width]
    y, x = np.unravel_index(means.argmax(), means.shape)
    return (int(x), int(y), width, height), float(means[y, x] / (width * height))
