"""What pruning would do and cost, within a few seconds: a look at some reduced views, and a few steps to measure their speed.

Child: `python -m svrgs_addon.jobs.estimate`, {"scene": file, "options": options of a job} as JSON on stdin; the result of estimate(),
or {"error": sentence}, on stdout.
"""

from __future__ import annotations

import json
import statistics
import sys
import time
from pathlib import Path

import numpy as np

from .. import native
from ..exit_status import guarded, plain
from ..files.registry import invisible, load_scene
from ..finetune import scores
from ..finetune.engine import NativeEngine
from ..finetune.methods import method_named
from ..finetune.model import Model
from ..finetune.plan import prune_plan
from ..finetune.run import Run
from ..finetune.saliency import saliency
from ..metrics.evaluate import mean_psnr, refuse_unseen, render_options
from ..native import Rasterizer
from ..option_kinds import check_mapping
from ..photographs.dataset import Dataset
from ..scene import Scene
from .options import PruneOptions
from .run_job import dataset_of, plan_of_pruning

LOOK_SECONDS, STEP_SECONDS = 0.8, 0.6  # at most, apart from reading
VIEWS = 8  # looked at, evenly spread over all
DROP_VIEWS = 2  # measured on, to find what a drop in dB allows
SIDE = 512  # pixels of a reduced view
SALIENCY_VIEWS = 24
STEPS = 3  # after one that is not measured
# Predicted as removed: a mean alpha T over its pixels below KNEE * (lambda_F / 1e-4)^SLOPE. Fitted to runs of method svr on one scene of
# photographs with lambda_F from 1e-5 to 1e-3: an expectation, no more.
KNEE, SLOPE = 0.0128, 0.37
FIXED_SHARE = 0.4  # of a step's time, which fewer Gaussians do not save


def estimate(options: PruneOptions) -> dict:
    """Keys: count; invisible: too faint for any image; unseen: in none of the views looked at; faint: below the first cut; kept: expected
    to stay, roughly; at_most: whether kept is an upper bound; seconds: expected; views: looked at; steps_per_second. Raises SplatError.
    """
    native.set_threads(options.threads)
    dataset = dataset_of(options)
    assert options.scene is not None
    scene = load_scene(options.scene).scene
    refuse_unseen(scene, dataset.cameras, "the splat")
    plan = plan_of_pruning(options)
    sums, peaks, hits, looked = _look(scene, dataset)
    kept = _expected(options, plan, scene, dataset, (sums, peaks, hits))
    share = kept / scene.count
    rate = _rate(scene, dataset, options)
    cost = lambda left: FIXED_SHARE + (1 - FIXED_SHARE) * left  # noqa: E731
    active = sum(phase.steps for phase in plan.phases if phase.active)
    return {
        "count": scene.count,
        "invisible": int(invisible(scene).sum()),
        "unseen": int((hits == 0).sum()),
        "faint": int((peaks < plan.min_contribution).sum()),
        "kept": max(1, kept),
        "at_most": bool(options.max_drop),
        "views": looked,
        "steps_per_second": rate,
        "seconds": (active * cost((1 + share) / 2) + (plan.total - active) * cost(share)) / rate,
    }


def _expected(options: PruneOptions, plan, scene: Scene, dataset: Dataset, seen: tuple) -> int:
    """How many Gaussians stay, roughly. seen: sums, maxima and pixels of alpha T, (N,) each."""
    sums, peaks, hits = seen
    if options.max_drop:
        return int(_within(scene, dataset, peaks, options.max_drop).sum())
    if plan.target:
        return plan.target
    kept = peaks >= plan.min_contribution
    if plan.method.learns_masks and options.iterations:
        kept &= sums > np.maximum(hits, 1) * _limit(plan.lambda_f or 1e-4)
    elif plan.lambda_f:
        kept &= _saliency(scene, dataset) > plan.lambda_f  # the rule of method pressure; of method saliency a first impression
    return int(kept.sum())


def _limit(lambda_f: float) -> float:
    return KNEE * (lambda_f / 1e-4) ** SLOPE


def _look(scene, dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Sums, maxima and pixels of alpha T over views spread over the training views, as many as time allows; and their number."""

    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    chosen = train[:: max(1, len(train) // VIEWS)][:VIEWS]
    sums, peaks, hits = np.zeros(scene.count), np.zeros(scene.count, np.float32), np.zeros(scene.count, np.int64)
    looked, end = 0, time.monotonic() + LOOK_SECONDS
    for index in chosen:
        camera = dataset.cameras[index]
        camera = camera.reduced(max(1, max(camera.width, camera.height) // SIDE))
        seen = scores.contribution(scene, [camera], rasterizer, options)
        sums, peaks, hits = sums + seen[0], np.maximum(peaks, seen[1]), hits + seen[2]
        looked += 1
        if time.monotonic() > end:
            break
    return sums, peaks, hits, looked


def _saliency(scene, dataset) -> np.ndarray:
    """By some views: it is a ratio of two sums over them, so that their number matters little."""

    train = dataset.train_indices or list(range(len(dataset.cameras)))
    cameras = [dataset.cameras[index] for index in train[:: max(1, len(train) // SALIENCY_VIEWS)][:SALIENCY_VIEWS]]
    return saliency(
        scene, [camera.reduced(max(1, max(camera.width, camera.height) // SIDE)) for camera in cameras], Rasterizer(), render_options(scene, dataset.background)
    )


def _within(scene, dataset, peaks: np.ndarray, drop: float) -> np.ndarray:
    """(N,) bool: how few of the highest peaks lose at most `drop` dB on a view or two, without any learning: more than a job keeps."""

    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    views, end = train[:: max(1, len(train) // DROP_VIEWS)][:DROP_VIEWS], time.monotonic() + LOOK_SECONDS
    psnr_of = lambda kept: mean_psnr(scene, dataset, views, rasterizer, options, kept)  # noqa: E731
    floor, few, enough = psnr_of(None) - drop, 0, scene.count
    while enough - few > max(1, scene.count // 100) and time.monotonic() < end:
        middle = (few + enough) // 2
        few, enough = (few, middle) if psnr_of(scores.top(peaks, middle).astype(np.uint8)) >= floor else (middle, enough)
    return scores.top(peaks, enough)


def _rate(scene: Scene, dataset: Dataset, options: PruneOptions) -> float:
    """Steps per second, of the first few. Steps of methods without masks are plain, but for a look now and then."""
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


def main() -> int:
    request = json.load(sys.stdin)
    result: dict = {}

    def work() -> int:
        options = check_mapping(PruneOptions, request["options"])
        result.update(estimate(PruneOptions(**options, scene=Path(request["scene"]))))
        return 0

    status = guarded(work, lambda sentence: result.update(error=sentence))
    print(json.dumps(plain(result)), flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
