"""The quality that is foreseen after pruning: PSNR on some test views, within about a second.

The views are rendered twice: with all Gaussians, and with only those that are expected to stay. The second pictures are those of a
removal without any learning: their squared error is larger by what the removed Gaussians showed. In a run, the Gaussians that stay
take over nearly all of that. The law, in mean squared errors:

    after = now + left * (removed - now),      left = 1 / (1 + steps / HALVED)

HALVED, the only fitted number of a method, is the number of steps that win back half of the added error. steps: all steps of the run.
Without a removal the forecast is the PSNR of now, and it is never higher: that further steps may still train the scene, and that fewer
Gaussians may fit few photographs less closely, is left out. benchmarks/forecast.py fits and tests it; docs/forecast.md says how near it is.
"""

from __future__ import annotations

import math
import time
from statistics import fmean
from typing import NamedTuple

import numpy as np

from ..finetune import scores
from ..finetune.plan import Plan
from ..finetune.views import as_real
from ..metrics.evaluate import render_options, rounded_to_8_bits
from ..metrics.psnr import psnr
from ..native import Rasterizer
from ..photographs.dataset import Dataset
from ..scene import Scene

HALVED = {"removal": 10.0, "svr": 59.0, "maskgs": 5.6}  # by name of the method; others are not foreseen
SECONDS, LEAST = 0.8, 2  # time limit of rendering views, without the last one; views that are rendered in any case
SIDE = 1024  # longer side of a view in pixels; a view of less than twice this size is not reduced
LEAST_STEPS = 800  # steps of a run below which nothing was measured
HIGHEST = 99.0  # PSNR of equal pictures, dB
GOLDEN = (math.sqrt(5) - 1) / 2


class Forecast(NamedTuple):
    """PSNRs in dB, means over the same views. The last two are None if the quality is not foreseen."""

    before: float  # of the scene as it is
    removed: float | None  # of the Gaussians that are expected to stay, without any learning
    after: float | None  # at the end of the run


def forecast(scene: Scene, dataset: Dataset, plan: Plan, ranking: np.ndarray, kept: int) -> Forecast:
    """The forecast for a run that keeps `kept` Gaussians, about those that are highest in `ranking` (N,): removal error for the methods that
    rank by it, else the largest alpha T. Views: test views, or training views if there are none. Raises FormatError, SceneError."""
    if not is_foreseen(plan):
        (before,) = _mean_psnrs(scene, dataset, [None])
        return Forecast(before, None, None)
    before, removed = _mean_psnrs(scene, dataset, [None, scores.top(ranking, kept).astype(np.uint8)])
    return Forecast(before, removed, psnr_after(before, removed, plan.total, HALVED[plan.method.name]))


def is_foreseen(plan: Plan) -> bool:
    """Whether the quality is foreseen. It is not for methods without a fitted number; with an allowed drop, which is the quality; for a run
    without steps in which the method prunes, or with fewer than LEAST_STEPS steps."""
    return plan.method.name in HALVED and not plan.max_drop and plan.prunes and plan.total >= LEAST_STEPS


def psnr_after(before: float, removed: float, steps: int, halved: float) -> float:
    """The law above, in dB. before, removed: PSNRs of now, and after the removal without any learning. steps: those of the run."""
    now, added = squared_error(before), max(0.0, squared_error(removed) - squared_error(before))
    return -10 * math.log10(now + added / (1 + steps / halved))


def squared_error(psnr_db: float) -> float:
    """The mean squared error, colours in 0..1, of a PSNR in dB."""
    return 10 ** (-psnr_db / 10)


def spread(views: list[int]) -> list[int]:
    """The views in an order whose first ones, however many, are spread over the list: by the fractions of multiples of the golden ratio."""
    return [views[place] for place in sorted(range(len(views)), key=lambda place: (place + 1) * GOLDEN % 1)]


def _mean_psnrs(scene: Scene, dataset: Dataset, kept: list[np.ndarray | None]) -> list[float]:
    """Mean PSNRs in dB of the scene with each of the masks (N,) uint8, over as many views as time allows."""
    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    rows: list[list[float]] = []
    end = time.monotonic() + SECONDS
    for index in spread(dataset.test_indices or dataset.train_indices):
        camera = dataset.cameras[index]
        factor = max(1, max(camera.width, camera.height) // SIDE)
        photo = as_real(dataset.image(index), np.dtype(np.float32), factor)
        images = (rasterizer.forward(scene, camera.reduced(factor), options, masks)["rgb"] for masks in kept)
        rows.append([min(HIGHEST, psnr(rounded_to_8_bits(image), photo)) for image in images])
        if len(rows) >= LEAST and time.monotonic() > end:
            break
    return [fmean(column) for column in zip(*rows, strict=True)]
