"""An estimate, within a few seconds, of how many Gaussians pruning would keep, how good the result would be and how long it would take.

It renders some views and measures the speed of a few steps. Child process: `python -m svrgs_addon.jobs.estimate`. It reads
{"scene": file, "options": options of a job} as JSON from stdin and writes the result of estimate(), or {"error": sentence}, to stdout.
"""

from __future__ import annotations

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from .. import native
from ..exit_status import answer
from ..files.registry import invisible, load_scene
from ..finetune import scores
from ..finetune.engine import NativeEngine
from ..finetune.methods import method_named
from ..finetune.methods.removal import Removal
from ..finetune.model import Model
from ..finetune.plan import Plan, prune_plan
from ..finetune.run import Run
from ..finetune.saliency import saliency
from ..metrics.evaluate import mean_psnr, refuse_unseen, render_options
from ..metrics.explained import mismatch_of
from ..native import Rasterizer
from ..option_kinds import check_mapping
from ..photographs.dataset import Dataset
from ..scene import Scene
from .options import PruneOptions
from .quality_forecast import forecast, spread
from .run_job import dataset_of, plan_of_pruning

VIEW_SECONDS, STEP_SECONDS = 0.8, 0.6  # time limits of rendering views and of measuring steps, without reading files
VIEWS = 8  # training views that are rendered
DROP_VIEWS = 2  # views on which PSNR is measured, if a drop is allowed
SIDE = 512  # longer side of a reduced view, pixels
RANKING_VIEWS = 24  # training views for what ranks the Gaussians: removal error, saliency, or the largest alpha T. Fewer leave too many Gaussians unseen
STEPS = 3  # steps that are measured, after one that is not
# For methods that learn masks, a Gaussian is predicted as removed if its mean alpha T over its pixels is below
# KNEE * (lambda_F / 1e-4)^SLOPE. Fitted to runs of method svr on one scene of photographs, with lambda_F from 1e-5 to 1e-3: a rough estimate.
KNEE, SLOPE = 0.0128, 0.37
FIXED_SHARE = 0.4  # share of a step's time that does not depend on the number of Gaussians


def estimate(options: PruneOptions) -> dict:
    """The estimate, a dict with these keys. Raises SplatError.

    count: Gaussians of the scene; invisible: those with an opacity below 1/255; unseen: those that no rendered view sees; faint: those
    that the first cut removes; kept: roughly how many stay; at_most: whether kept is an upper bound; views: number of rendered views;
    psnr_before, psnr_removed, psnr_after: PSNR in dB on some test views: of the scene, of the Gaussians that stay before any learning, and
    at the end of the run, the last two None if the quality is not foreseen (quality_forecast.py); steps_per_second; seconds: expected time
    of the run; notes: sentences on the dataset and whether the splat belongs to it.
    """
    native.set_threads(options.threads)
    dataset = dataset_of(options)
    assert options.scene is not None
    scene = load_scene(options.scene).scene
    refuse_unseen(scene, dataset.cameras, "the splat")
    plan = plan_of_pruning(options)
    sums, peaks, hits, views = _contributions(scene, dataset, RANKING_VIEWS if plan.method.learns_masks else VIEWS)
    ranking = _measured(plan.method.ranking, scene, dataset) if isinstance(plan.method, Removal) and not plan.max_drop else peaks
    kept = max(1, _expected(options, plan, scene, dataset, (sums, peaks, hits)))
    quality = forecast(scene, dataset, plan, ranking, kept)
    share = kept / scene.count
    rate = _rate(scene, dataset, options)
    relative_time = lambda left: FIXED_SHARE + (1 - FIXED_SHARE) * left  # noqa: E731
    active = sum(phase.steps for phase in plan.phases if phase.active)
    return {
        "count": scene.count,
        "invisible": int(invisible(scene).sum()),
        "unseen": int((hits == 0).sum()),
        "faint": int((peaks < plan.min_contribution).sum()),
        "kept": kept,
        "at_most": bool(options.max_drop),
        "views": views,
        **{f"psnr_{name}": value for name, value in quality._asdict().items()},
        "steps_per_second": rate,
        "notes": [*dataset.notes, *filter(None, [mismatch_of(scene, dataset)])],
        "seconds": (active * relative_time((1 + share) / 2) + (plan.total - active) * relative_time(share)) / rate,
    }


def _expected(options: PruneOptions, plan: Plan, scene: Scene, dataset: Dataset, seen: tuple) -> int:
    """Roughly how many Gaussians stay. seen: sums and maxima of alpha T, and numbers of pixels, (N,) each."""
    sums, peaks, hits = seen
    if options.max_drop:
        return int(_fewest_within(scene, dataset, peaks, options.max_drop).sum())
    if plan.target:
        return plan.target
    kept = peaks >= plan.min_contribution
    if plan.method.learns_masks and options.iterations:
        kept &= sums > np.maximum(hits, 1) * _limit(plan.lambda_f or 1e-4)
    elif isinstance(plan.method, Removal):
        kept &= _measured(saliency, scene, dataset) > plan.lambda_f
    return int(kept.sum())


def _limit(lambda_f: float) -> float:
    return KNEE * (lambda_f / 1e-4) ** SLOPE


def _contributions(scene, dataset, limit: int) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Sums and maxima of alpha T and numbers of pixels, (N,) each, over at most `limit` training views, as time allows; and their number."""
    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    chosen = spread(dataset.train_indices or list(range(len(dataset.cameras))))[:limit]
    sums, peaks, hits = np.zeros(scene.count), np.zeros(scene.count, np.float32), np.zeros(scene.count, np.int64)
    views, end = 0, time.monotonic() + VIEW_SECONDS
    for index in chosen:
        camera = dataset.cameras[index]
        camera = camera.reduced(max(1, max(camera.width, camera.height) // SIDE))
        seen = scores.contribution(scene, [camera], rasterizer, options)
        sums, peaks, hits = sums + seen[0], np.maximum(peaks, seen[1]), hits + seen[2]
        views += 1
        if time.monotonic() > end:
            break
    return sums, peaks, hits, views


def _measured(ranking: Callable, scene, dataset) -> np.ndarray:
    """Saliency or removal error (N,), from some of the views."""
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    cameras = [dataset.cameras[index] for index in train[:: max(1, len(train) // RANKING_VIEWS)][:RANKING_VIEWS]]
    return ranking(
        scene, [camera.reduced(max(1, max(camera.width, camera.height) // SIDE)) for camera in cameras], Rasterizer(), render_options(scene, dataset.background)
    )


def _fewest_within(scene, dataset, peaks: np.ndarray, drop: float) -> np.ndarray:
    """(N,) bool: the fewest Gaussians of largest alpha T (N,) that lose at most `drop` dB on two views, without learning. A job keeps fewer."""
    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    views, end = train[:: max(1, len(train) // DROP_VIEWS)][:DROP_VIEWS], time.monotonic() + VIEW_SECONDS
    psnr_of = lambda kept: mean_psnr(scene, dataset, views, rasterizer, options, kept)  # noqa: E731
    floor, few, enough = psnr_of(None) - drop, 0, scene.count
    while enough - few > max(1, scene.count // 100) and time.monotonic() < end:
        middle = (few + enough) // 2
        few, enough = (few, middle) if psnr_of(scores.top(peaks, middle).astype(np.uint8)) >= floor else (middle, enough)
    return scores.top(peaks, enough)


def _rate(scene: Scene, dataset: Dataset, options: PruneOptions) -> float:
    """Steps per second, measured on a few steps. For methods that learn no masks, steps of plain 3DGS are measured, which are nearly the same."""
    method = method_named(options.method)
    plan = prune_plan(method if method.learns_masks else method_named("3dgs"), max(STEPS + 2, options.iterations), STEPS + 2)
    run = Run(Model.of(scene), dataset, plan, NativeEngine(), scene.antialiased)
    seconds: list[float] = []
    end = time.monotonic() + STEP_SECONDS
    try:
        run.advance()
        while len(seconds) < STEPS and (time.monotonic() < end or not seconds):
            started = time.perf_counter()
            run.advance()
            seconds.append(time.perf_counter() - started)
    finally:
        run.close()
    return 1 / statistics.median(seconds)


def _estimate_request(request: dict) -> dict:
    options = check_mapping(PruneOptions, request["options"])
    return estimate(PruneOptions(**options, scene=Path(request["scene"])))


if __name__ == "__main__":
    sys.exit(answer(_estimate_request))
