"""PSNR on a few views, the fewest Gaussians that reach a given PSNR, and the law of what the steps of a run
win back of a removal.

The law, in mean squared errors of the scene as it is (now), after a removal without any learning (removed),
and at the end of the run (after):

    after = now + left * (removed - now),      left = 1 / (1 + steps / HALVED)

The removed Gaussians leave an error; those that stay take over nearly all of it. HALVED, Method.halved, the
only fitted number of a method, is the number of steps that win back half of it. Without a removal nothing
changes: that steps may still train the scene, and that fewer Gaussians may fit few photographs less closely,
is left out.
benchmarks/forecast.py fits and tests it; docs/forecast.md says how near it is.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import TYPE_CHECKING

import numpy as np

from .run_view import RunView
from .scores import top

if TYPE_CHECKING:  # reads files; a Blender that only starts needs none of it
    from ..views.dataset import Dataset

# least share of the Gaussians that an allowed drop keeps: in a poor scene, PSNR alone would be held by some
# large blurs
LEAST = 0.05
VIEWS = 16  # most views on which a drop in PSNR is measured, spread evenly over the test views


def quality_views(dataset: Dataset) -> list[int]:
    """The views on which a drop in PSNR is measured: test views, because training fits its own views more
    closely than any other; training views if there are none."""
    views = dataset.test_indices or dataset.train_indices
    count = min(VIEWS, len(views))
    return [views[k * len(views) // count] for k in range(count)]


def fewest_within(run: RunView, score: np.ndarray, floor: float) -> np.ndarray:
    """(N,) bool: the Gaussians of highest score, as few as have a PSNR of at least `floor` dB, but at least
    LEAST of those at the start. score (N,). To 0.1 % of N."""
    few, count = min(math.ceil(LEAST * run.initial_count) - 1, run.model.count), run.model.count
    return top(
        score, bisected(few, count, count // 1_000, lambda middle: run.psnr(top(score, middle)) >= floor)
    )


def bisected(few: int, enough: int, step: int, within: Callable[[int], bool]) -> int:
    """The smallest number above `few` for which within() holds, or up to `step` more. It holds for `enough`,
    and for more than any for which it does."""
    while enough - few > max(1, step):
        middle = (few + enough) // 2
        few, enough = (few, middle) if within(middle) else (middle, enough)
    return enough


def psnr_after(before: float, removed: float, steps: int, halved: float) -> float:
    """The law above, in dB. before, removed: PSNRs of now, and after the removal without any learning. steps:
    those of the run. Never above `before`."""
    now, added = squared_error(before), max(0.0, squared_error(removed) - squared_error(before))
    return -10 * math.log10(now + added / (1 + steps / halved))


def psnr_removed(before: float, after: float, steps: int, halved: float) -> float:
    """The law above the other way round: the PSNR that a removal may leave without any learning, so that
    `after` dB are reached. after < before."""
    now, added = squared_error(before), squared_error(after) - squared_error(before)
    return -10 * math.log10(now + added * (1 + steps / halved))


def squared_error(psnr_db: float) -> float:
    """The mean squared error, colours in 0..1, of a PSNR in dB."""
    return 10 ** (-psnr_db / 10)
