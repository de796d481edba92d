"""Roughly how many Gaussians a run of `svrgs prune` keeps, from a few views and within about a second,
without a step of it."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import cached_property
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
from .quality_forecast import in_time, spread

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


class Expected:
    """What is expected of a run: each is found out from a few views when it is first asked for."""

    def __init__(self, plan: Plan, scene: Scene, dataset: Dataset):
        self.plan, self.scene, self.dataset = plan, scene, dataset
        self._views = dataset.train_indices or list(range(len(dataset.cameras)))

    @cached_property
    def seen(self) -> Seen:
        """What some training views see, as many as time allows."""
        scene, viewed = self.scene, ViewedScene.of(self.scene, [], self.dataset.background)
        chosen = spread(self._views)[: RANKING_VIEWS if self.plan.method.learns_masks else VIEWS]
        sums, hits = np.zeros(scene.count), np.zeros(scene.count, np.int64)
        peaks, views = np.zeros(scene.count, np.float32), 0
        for index in in_time(chosen, VIEW_SECONDS):
            found = scores.contribution(replace(viewed, cameras=[self._reduced(index)]))
            sums, peaks, hits = sums + found[0], np.maximum(peaks, found[1]), hits + found[2]
            views += 1
        return Seen(sums, peaks, hits, views)

    @cached_property
    def kept(self) -> int:
        """Roughly how many Gaussians stay, at least 1. With an allowed drop an upper bound."""
        plan = self.plan
        if plan.max_loss:
            return self._fewest_within_loss()
        if plan.target:
            return min(plan.target, self.scene.count)
        seen = self.seen
        kept = seen.peaks >= plan.min_contribution
        if plan.method.learns_masks and plan.prunes:
            kept &= seen.sums > np.maximum(seen.hits, 1) * KNEE * ((plan.lambda_f or 1e-4) / 1e-4) ** SLOPE
        elif isinstance(plan.method, Removal):
            kept &= self._from_some(saliency) > plan.lambda_f
        return max(1, int(kept.sum()))

    @cached_property
    def order(self) -> np.ndarray:
        """The Gaussians that are expected to stay are highest in it, (N,): removal error for the methods that
        rank by it, else the largest alpha T."""
        method = self.plan.method
        return self._from_some(method.ranking) if isinstance(method, Removal) else self.seen.peaks

    def _from_some(self, ranking: Callable[[ViewedScene], np.ndarray]) -> np.ndarray:
        """Saliency or removal error (N,), from some of the views."""
        views = list(map(self._reduced, spaced(self._views, RANKING_VIEWS)))
        return ranking(ViewedScene.of(self.scene, views, self.dataset.background))

    def _reduced(self, index: int) -> Camera:
        camera = self.dataset.cameras[index]
        return camera.reduced(reduction_to(SIDE, camera))

    def _fewest_within_loss(self) -> int:
        """The fewest Gaussians that are highest in the order and hold the allowed loss on some reduced views,
        as many as DROP_SECONDS allow: without learning, or for `removal` and `saliency` by the law of
        finetune/quality.py. A job keeps fewer."""
        plan, scene, dataset, order = self.plan, self.scene, self.dataset, self.order
        rasterizer, options = Rasterizer(), picture_options(scene, dataset.background)
        views, found = list[tuple[Camera, np.ndarray]](), list[float]()

        def quality(number: int, mask: np.ndarray | None) -> float:
            camera, photo = views[number]
            image = rounded_to_8_bits(rasterizer.forward(scene, camera, options, mask)["rgb"])
            return quality_of_view(image, photo, camera, plan.measure, dataset.unexplained, number)

        indices = spread(quality_views(dataset))
        read = (reduced_view(dataset.cameras[index], dataset.image(index), SIDE) for index in indices)
        for view in in_time(read, DROP_SECONDS, DROP_VIEWS):
            views.append(view)
            found.append(quality(len(found), None))
        before = fmean(found)
        floor = floor_of_drop(before, plan) if isinstance(plan.method, Removal) else before - plan.max_loss

        def within(count: int) -> bool:
            mask = scores.top(order, count).astype(np.uint8)
            return fmean(quality(number, mask) for number in range(len(views))) >= floor

        return fewest(math.ceil(MIN_SHARE * scene.count), scene.count, within)
