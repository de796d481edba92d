"""The quality that is foreseen after pruning: PSNR on some test views, within about a second.

The views are rendered twice: with all Gaussians, and with only those that are expected to stay. The second
pictures are those of a removal without any learning. How much of that a run wins back is the law of
finetune/quality.py.
"""

from __future__ import annotations

import math
import time
from collections.abc import Iterable, Iterator
from statistics import fmean
from typing import NamedTuple, TypeVar

import numpy as np

from ..finetune import scores
from ..finetune.plan import Plan
from ..finetune.quality import psnr_after
from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options, rounded_to_8_bits
from ..render.metrics.measures import psnr
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.reduced_photos import reduced_view

# time limit of rendering views, without the last one; views that are rendered in any case
SECONDS, MIN_FORECAST_VIEWS = 0.8, 2
SIDE = 1024  # longer side of a view in pixels; a view of less than twice this size is not reduced
LEAST_STEPS = 800  # steps of a run below which nothing was measured
HIGHEST = 99.0  # PSNR of equal pictures, dB
Item = TypeVar("Item")
GOLDEN = (math.sqrt(5) - 1) / 2


class Forecast(NamedTuple):
    """PSNRs in dB, means over the same views. The last two are None if the quality is not foreseen."""

    before: float  # of the scene as it is
    removed: float | None  # of the Gaussians that are expected to stay, without any learning
    after: float | None  # at the end of the run


def forecast(scene: Scene, dataset: Dataset, plan: Plan, ranking: np.ndarray, kept: int) -> Forecast:
    """The forecast for a run that keeps `kept` Gaussians, about those that are highest in `ranking` (N,):
    removal error for the methods that rank by it, else the largest alpha T. Views: test views, or training
    views if there are none. Raises FormatError, SceneError."""
    if not is_foreseen(plan):
        (before,) = _mean_psnrs(scene, dataset, [None])
        return Forecast(before, None, None)
    before, removed = _mean_psnrs(scene, dataset, [None, scores.top(ranking, kept).astype(np.uint8)])
    return Forecast(before, removed, psnr_after(before, removed, plan.total, plan.method.halved))


def is_foreseen(plan: Plan) -> bool:
    """Whether the quality is foreseen. It is not for methods without a fitted number; with an allowed drop,
    which is the quality; with fewer SH bands; for a run without steps in which the method prunes, or with
    fewer than LEAST_STEPS steps."""
    measured = plan.total >= LEAST_STEPS and plan.sh_degree == 3
    return plan.method.halved > 0 and not plan.max_loss and plan.prunes and measured


def spread(views: list[int]) -> list[int]:
    """The views in an order whose first ones, however many, are spread over the list: by the fractions of
    multiples of the golden ratio."""
    return [views[place] for place in sorted(range(len(views)), key=lambda place: (place + 1) * GOLDEN % 1)]


def in_time(items: Iterable[Item], seconds: float, least: int = 1) -> Iterator[Item]:
    """The items, until what is done with them has taken so many seconds; `least` of them in any case."""
    spent = 0.0
    for number, item in enumerate(items):
        if number >= least and spent > seconds:
            return
        started = time.monotonic()
        yield item
        spent += time.monotonic() - started


def _mean_psnrs(scene: Scene, dataset: Dataset, kept: list[np.ndarray | None]) -> list[float]:
    """Mean PSNRs in dB of the scene with each of the masks (N,) uint8, over as many views as time allows."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
    rows: list[list[float]] = []
    views = spread(dataset.test_indices or dataset.train_indices)
    for index in in_time(views, SECONDS, MIN_FORECAST_VIEWS):
        camera, photo = reduced_view(dataset.cameras[index], dataset.image(index), SIDE)
        images = (rasterizer.forward(scene, camera, options, masks)["rgb"] for masks in kept)
        rows.append(
            [min(HIGHEST, psnr(rounded_to_8_bits(image), photo, camera.valid_share)) for image in images]
        )
    return [fmean(column) for column in zip(*rows, strict=True)]
