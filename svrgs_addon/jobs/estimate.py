"""What pruning would do and cost, within a few seconds: a look at some reduced views, and a few steps to see how fast they are.

Child: `python -m svrgs_addon.jobs.estimate`, {scene, colmap, images, method, lambda_f, target_count, max_drop, iterations,
recovery, min_contribution, holdout, threads} as JSON on stdin; estimate()'s result or {"error": sentence} on stdout.
"""

from __future__ import annotations

import json
import math
import statistics
import sys
import time
from pathlib import Path

import numpy as np

from ..exit_status import guarded

LOOK_SECONDS, STEP_SECONDS = 0.8, 0.6  # at most, beside reading
VIEWS = 8  # looked at, spread over all
DROP_VIEWS = 2  # measured on, to find what a loss in dB allows
SIDE = 512  # pixels of a reduced view
WORTH_VIEWS = 24
STEPS = 3  # after one that is not measured
# Masks drop what the pixels it covers see least of: alpha T, in the mean over them, below about KNEE (lambda_f / 1e-4)^SLOPE.
# Fitted to runs of method svr-mask on one scene of photographs with lambda_f from 1e-5 to 1e-3: an expectation, no more.
KNEE, SLOPE = 0.0128, 0.37
FIXED_SHARE = 0.4  # of a step's time, that fewer Gaussians do not save


def estimate(request: dict) -> dict:
    """count; invisible: too faint for any picture; unseen: in none of the views looked at; faint: below the first cut; kept:
    expected to stay, roughly; at_most: no more than that; seconds: expected; views: looked at; steps_per_second. Raises SplatError.
    """
    from .. import native
    from ..files.registry import invisible, load_scene
    from ..finetune.methods import METHODS
    from ..metrics.evaluate import refuse_unseen
    from ..photographs.dataset import load_dataset

    native.set_threads(request["threads"])
    dataset = load_dataset(Path(request["colmap"]), request["images"] or None, holdout=request["holdout"])
    scene = load_scene(Path(request["scene"])).scene
    refuse_unseen(scene, dataset.cameras, "the splat")
    sums, peaks, hits, looked = _look(scene, dataset)
    method = METHODS[request["method"]]
    limit = request.get("min_contribution", 0.0)
    kept = peaks >= limit
    lambda_f = request.get("lambda_f") or method.lambda_f
    if method.learns_masks and request["iterations"]:
        kept &= sums > np.maximum(hits, 1) * _limit(lambda_f or 1e-4)
    elif lambda_f and not request.get("target_count") and not request.get("max_drop"):
        kept &= _worth(scene, dataset) > lambda_f  # what `svr` goes by; of `svr-worth` a first impression
    if request.get("max_drop"):
        kept = _within(scene, dataset, peaks, request["max_drop"])
    share = (request.get("target_count") or (0 if request.get("max_drop") else method.share * scene.count) or int(kept.sum())) / scene.count
    rate = _rate(scene, dataset, request)
    learning = sum(phase.steps for phase in method.prune_phases(request["iterations"], 0, 1))
    cost = lambda left: FIXED_SHARE + (1 - FIXED_SHARE) * left  # noqa: E731
    return {
        "count": scene.count,
        "invisible": int(invisible(scene).sum()),
        "unseen": int((hits == 0).sum()),
        "faint": int((peaks < limit).sum()),
        "kept": max(1, round(share * scene.count)),
        "at_most": bool(request.get("max_drop")),
        "views": looked,
        "steps_per_second": rate,
        "seconds": (learning * cost((1 + share) / 2) + request["recovery"] * cost(share)) / rate,
    }


def _limit(lambda_f: float) -> float:
    return KNEE * (lambda_f / 1e-4) ** SLOPE


def _look(scene, dataset) -> tuple[np.ndarray, np.ndarray, np.ndarray, int]:
    """Sums, maxima and pixels of alpha T over views spread over the training views, as many as time allows; and their number."""
    from ..finetune import scores
    from ..metrics.evaluate import render_options
    from ..native import Rasterizer

    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    chosen = train[:: max(1, len(train) // VIEWS)][:VIEWS]
    total, looked, end = None, 0, time.monotonic() + LOOK_SECONDS
    for index in chosen:
        camera = dataset.cameras[index]
        camera = camera.reduced(max(1, max(camera.width, camera.height) // SIDE))
        seen = scores.contribution(scene, [camera], rasterizer, options)
        total = seen if total is None else (total[0] + seen[0], np.maximum(total[1], seen[1]), total[2] + seen[2])
        looked += 1
        if time.monotonic() > end:
            break
    return *total, looked


def _worth(scene, dataset) -> np.ndarray:
    """By some views: it is a ratio of two sums over them, so that their number matters little."""
    from ..finetune.saliency import worth
    from ..metrics.evaluate import render_options
    from ..native import Rasterizer

    train = dataset.train_indices or list(range(len(dataset.cameras)))
    cameras = [dataset.cameras[index] for index in train[:: max(1, len(train) // WORTH_VIEWS)][:WORTH_VIEWS]]
    return worth(
        scene, [camera.reduced(max(1, max(camera.width, camera.height) // SIDE)) for camera in cameras], Rasterizer(), render_options(scene, dataset.background)
    )


def _within(scene, dataset, peaks: np.ndarray, drop: float) -> np.ndarray:
    """(N,) bool: how few of the highest peaks lose at most `drop` dB on a view or two, without any learning: more than a job keeps."""
    from ..finetune.scores import top
    from ..metrics.evaluate import mean_psnr, render_options
    from ..native import Rasterizer

    rasterizer, options = Rasterizer(), render_options(scene, dataset.background)
    train = dataset.train_indices or list(range(len(dataset.cameras)))
    views, end = train[:: max(1, len(train) // DROP_VIEWS)][:DROP_VIEWS], time.monotonic() + LOOK_SECONDS
    psnr_of = lambda kept: mean_psnr(scene, dataset, views, rasterizer, options, kept)  # noqa: E731
    floor, few, enough = psnr_of(None) - drop, 0, scene.count
    while enough - few > max(1, scene.count // 100) and time.monotonic() < end:
        middle = (few + enough) // 2
        few, enough = (few, middle) if psnr_of(top(peaks, middle).astype(np.uint8)) >= floor else (middle, enough)
    return top(peaks, enough)


def _rate(scene, dataset, request: dict) -> float:
    """Steps a second, of the first few."""
    from ..finetune.engine import NativeEngine
    from ..finetune.loop import Run
    from ..finetune.methods import METHODS
    from ..finetune.model import Model
    from ..finetune.plan import prune_settings

    method = request["method"] if METHODS[request["method"]].learns_masks else "3dgs"  # others' steps are plain but for a look now and then
    settings = prune_settings(method, max(STEPS + 2, request["iterations"]), STEPS + 2)
    run = Run(Model.of(scene), dataset, settings, NativeEngine(), scene.antialiased)
    seconds, end = [], time.monotonic() + STEP_SECONDS
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
    request, result = json.load(sys.stdin), {}

    def work() -> int:
        result.update(estimate(request))
        return 0

    status = guarded(work, lambda sentence: result.update(error=sentence))
    print(json.dumps({name: None if isinstance(value, float) and not math.isfinite(value) else value for name, value in result.items()}), flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
