"""Searches by quality: the fewest Gaussians that reach a given one, and the share of fine-tuning that does
best; and the law of what the steps of a run win back of a removal.

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
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from ..scene.camera import apart
from .run_view import RunView
from .scores import top

if TYPE_CHECKING:  # reads files; a Blender that only starts needs none of it
    from ..views.dataset import Dataset

# least share of the Gaussians that an allowed drop keeps: large blurs would hold the PSNR of a poor scene
MIN_SHARE = 0.05
# shares of the fine-tuned scene in a result, the rest is the scene before the steps; tried after 1
SHARES = (0.75, 0.5, 0.25, 0.0)
VIEWS = 16  # most views on which a drop in PSNR is held, evenly spread, at most half of the test views
SPARED, LEAST_SPARED = 8, 2
NOT_APART = (
    "there are fewer than two test views: the quality is measured in the views that decided how many"
    " Gaussians stay"
)


def hold_apart(dataset: Dataset, measure: str = "psnr") -> Dataset:
    """The dataset, with some views taken for decisions, in which nothing is trained or measured. measure: a
    key of MEASURES.

    For PSNR up to half of the test views: a training view loses far more of it than any other. Losses of FLIP
    and LPIPS are about the same there, but differ from view to view, and test views are few: so for these
    every SPARED-th training view, at least LEAST_SPARED, and all test views measure."""
    trained = dataset.train_indices
    if measure != "psnr" and len(trained) >= SPARED:
        decide, train = apart(trained, min(VIEWS, max(LEAST_SPARED, len(trained) // SPARED)))
        return replace(dataset, deciding_indices=decide, train_indices=train)
    decide, test = apart(dataset.test_indices, VIEWS)
    return replace(dataset, deciding_indices=decide, test_indices=test)


def quality_views(dataset: Dataset) -> list[int]:
    """The views on which an allowed loss is held: those that are taken for it, or else test views, because
    training fits its own views more closely than any other; training views if there are none."""
    views = dataset.deciding_indices or dataset.test_indices or dataset.train_indices
    count = min(VIEWS, len(views))
    return [views[k * len(views) // count] for k in range(count)]


def fewest_within(run: RunView, score: np.ndarray, floor: float) -> np.ndarray:
    """(N,) bool: the Gaussians of highest score, as few as have a quality of at least `floor`, but at least
    MIN_SHARE of those at the start. score (N,). To 0.1 % of N; with LPIPS, which takes long, to 1 %."""
    parts = 100 if run.plan.measure == "lpips" else 1_000
    least, count = math.ceil(MIN_SHARE * run.initial_count), run.model.count
    return top(score, fewest(least, count, lambda some: run.quality(top(score, some)) >= floor, parts))


def fewest(least: int, count: int, within: Callable[[int], bool], parts: int = 100) -> int:
    """The smallest number of `count` Gaussians, at least `least`, for which within() holds; too large by one
    `parts`-th of them at most. It holds for all, and for more than any for which it does."""
    few, enough = min(least - 1, count), count
    while enough - few > max(1, count // parts):
        middle = (few + enough) // 2
        few, enough = (few, middle) if within(middle) else (middle, enough)
    return enough


def best_share(quality: Callable[[float], float]) -> float:
    """The share of the fine-tuned scene in the result, less than 1 where fine-tuning does harm. quality: of a
    share. Shares are tried from 1 down, as long as the quality rises."""
    best, highest = 1.0, quality(1.0)
    for share in SHARES:
        if (found := quality(share)) <= highest:
            break
        best, highest = share, found
    return best


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
