"""Nested scenes (`svrgs prune --nested`; docs/methods.md): each smaller number of Gaussians is a good splat
too.

As in Matryoshka Gaussian Splatting (arXiv 2603.19234), the Gaussians have an order, and steps train random
prefixes of it. Here it is found once, before the recovery: from SIZES numbers, the Gaussians of lowest
removal error go, measured with those that are left. Half of the recovery's steps train all Gaussians, the
others one of the smaller numbers. A prefix is the first rows of every array, so such a step copies nothing
and costs less.
"""

from __future__ import annotations

import numpy as np

from ..scene.morton_order import morton_order
from .run_view import RunView
from .saliency import removal_errors
from .scores import top
from .settings import Phase, Settings

SIZES = 8  # smaller numbers of Gaussians that are trained; each is the same share of the next
WHOLE = 0.5  # share of the steps that train all Gaussians
_STREAM = 5  # of the random numbers that choose the size


def smaller_sizes(count: int, smallest: float) -> list[int]:
    """The numbers trained beside all `count`, from large to small. smallest: share of the last."""
    return [max(1, round(count * smallest ** (k / SIZES))) for k in range(1, SIZES + 1)]


def nested_order(run: RunView) -> np.ndarray:
    """The rows of the run's Gaussians, (N,), the most important first; of one size in Morton order."""
    model = run.model
    within, kept = np.zeros(model.count, np.int64), np.ones(model.count, bool)
    for size in smaller_sizes(model.count, run.plan.nested):
        error = removal_errors(run.viewed, kept)
        kept = top(np.where(kept, error, -1), size)
        within += kept
    place = np.empty(model.count, np.int64)
    place[morton_order(model.means)] = np.arange(model.count)
    return np.lexsort((place, -within))


def size_of_step(settings: Settings, phase: Phase, iteration: int, count: int) -> int:
    """How many of the `count` Gaussians, the first ones, the step after `iteration` steps trains."""
    if not settings.nested or phase.name != "recover":
        return count
    rng = np.random.default_rng([settings.seed, _STREAM, iteration])
    return count if rng.random() < WHOLE else int(rng.choice(smaller_sizes(count, settings.nested)))
