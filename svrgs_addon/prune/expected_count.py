"""Roughly how many Gaussians a run of `svrgs prune` keeps, from a few views and within about a second,
without a step of it."""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import replace
from statistics import fmean
from typing import NamedTuple

import numpy as np

from ..finetune import scores
from ..finetune.methods.removal import Removal, floor_of_drop
from ..finetune.plan import Plan
from ..finetune.quality import MIN_SHARE, fewest, quality_views
from ..finetune.saliency import saliency
from ..finetune.viewed_scene import ViewedScene
from ..native.rasterizer import Rasterizer
from ..render.metrics.evaluate import picture_options, quality_of_view, rounded_to_8_bits
from ..scene.camera import Camera, spaced
from ..scene.gaussians import Scene
from ..views.dataset import Dataset
from ..views.reduced_photos import reduced_view, reduction_to
from .quality_forecast import spread

VIEW_SECONDS = 0.8  # time limit of rendering views, without reading files
VIEWS = 8  # training views that are rendered
# if a drop is allowed: fewest views on which PSNR is measured; time limit of measuring it once
DROP_VIEWS, DROP_SECONDS = 2, 0.15
SIDE = 512  # longer side of a reduced view, pixels
# training views for what ranks the Gaussians: removal error, saliency, or the largest alpha T. Fewer leave
# too many Gaussians unseen
RANKING_VIEWS = 24
# For methods that learn masks, a Gaussian is predicted as removed if its mean alpha T over its pixels is
# below KNEE * (lambda_F / 1e-4)^SLOPE. Fitted to runs of method svr on one scene of photographs, with
# lambda_F from 1e-5 to 1e-3: a rough estimate.
KNEE, SLOPE = 0.0128, 0.37


class Seen(NamedTuple):
    """What some training views see of each Gaussian, (N,) each; and their number."""

    sums: np.ndarray  # sum of alpha T, float64
    peaks: np.ndarray  # largest alpha T, float32
    hits: np.ndarray  # pixels in which it is blended, int64
    views: int


def seen_by_some(scene: Scene, dataset: Dataset, plan: Plan) -> Seen:
    """What some training views see, as many as time allows."""
    viewed = ViewedScene.of(scene, [], dataset.background)
    chosen = spread(_views(dataset))[: RANKING_VIEWS if plan.method.learns_masks else VIEWS]
    sums, hits = np.zeros(scene.count), np.zeros(scene.count, np.int64)
    peaks = np.zeros(scene.count, np.float32)
    views, end = 0, time.monotonic() + VIEW_SECONDS
    for index in chosen:
        found = scores.contribution(replace(viewed, cameras=[_reduced(dataset.cameras[index])]))
        sums, peaks, hits = sums + found[0], np.maximum(peaks, found[1]), hits + found[2]
        views += 1
        if time.monotonic() > end:
            break
    return Seen(sums, peaks, hits, views)


def expected_count(plan: Plan, scene: Scene, dataset: Dataset, seen: Seen) -> int:
    """Roughly how many Gaussians stay, at least 1. With an allowed drop an upper bound."""
    if plan.max_loss:
        return _fewest_within_drop(scene, dataset, expected_order(plan, scene, dataset, seen), plan)
    if plan.target:
        return min(plan.target, scene.count)
    kept = seen.peaks >= plan.min_contribution
    if plan.method.learns_masks and plan.prunes:
        kept &= seen.sums > np.maximum(seen.hits, 1) * KNEE * ((plan.lambda_f or 1e-4) / 1e-4) ** SLOPE
    elif isinstance(plan.method, Removal):
        kept &= _from_some(saliency, scene, dataset) > plan.lambda_f
    return max(1, int(kept.sum()))


def expected_order(plan: Plan, scene: Scene, dataset: Dataset, seen: Seen) -> np.ndarray:
    """The Gaussians that are expected to stay are highest in it, (N,): removal error for the methods that
    rank by it, else the largest alpha T."""
    return _from_some(plan.method.ranking, scene, dataset) if isinstance(plan.method, Removal) else seen.peaks


def _from_some(ranking: Callable, scene: Scene, dataset: Dataset) -> np.ndarray:
    """Saliency or removal error (N,), from some of the views."""
    views = [_reduced(dataset.cameras[index]) for index in spaced(_views(dataset), RANKING_VIEWS)]
    return ranking(ViewedScene.of(scene, views, dataset.background))


def _views(dataset: Dataset) -> list[int]:
    return dataset.train_indices or list(range(len(dataset.cameras)))


def _reduced(camera: Camera) -> Camera:
    return camera.reduced(reduction_to(SIDE, camera))


def _fewest_within_drop(scene: Scene, dataset: Dataset, order: np.ndarray, plan: Plan) -> int:
    """The fewest Gaussians that are highest in `order` (N,) and hold the allowed loss on some views: without
    learning, or for `removal` and `saliency` by the law of finetune/quality.py. A job keeps fewer."""
    before, quality_of = _quality_on_some(scene, dataset, plan.measure)
    floor = floor_of_drop(before, plan) if isinstance(plan.method, Removal) else before - plan.max_loss
    within = lambda count: quality_of(scores.top(order, count).astype(np.uint8)) >= floor
    return fewest(math.ceil(MIN_SHARE * scene.count), scene.count, within)


def _quality_on_some(
    scene: Scene, dataset: Dataset, measure: str
) -> tuple[float, Callable[[np.ndarray | None], float]]:
    """The quality of the scene (quality_of_view()), and the function that measures it with a mask (N,) uint8:
    on as many reduced views as DROP_SECONDS allow."""
    rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)

    def quality(number: int, mask: np.ndarray | None) -> float:
        camera, photo = views[number]
        image = rounded_to_8_bits(rasterizer.forward(scene, camera, options, mask)["rgb"])
        return quality_of_view(image, photo, camera, measure, dataset.unexplained, number)

    views, found, seconds = [], [], 0.0
    for index in spread(quality_views(dataset)):
        views.append(reduced_view(dataset.cameras[index], dataset.image(index), SIDE))
        started = time.monotonic()
        found.append(quality(len(views) - 1, None))
        seconds += time.monotonic() - started
        if len(views) >= DROP_VIEWS and seconds > DROP_SECONDS:
            break
    return fmean(found), lambda mask: fmean(quality(number, mask) for number in range(len(views)))
