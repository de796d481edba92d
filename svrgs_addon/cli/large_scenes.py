"""`svrgs large`: scenes larger than memory. `prune` does all of it; `divide`, `score`, `reduce`, `merge`,
`decide`, `cut`, `tune` and `finish` are its steps, for a farm."""

from __future__ import annotations

import argparse
import functools
import math
from collections.abc import Callable
from typing import Any

from ..files.registry import format_to_read
from ..jobs.farm.engine_messages import Messages
from ..native import library
from ..prune.blocks.divided import Divided, clear, divide
from ..prune.blocks.folder import prepare, refuse_foreign, scored_views
from ..prune.blocks.learning import decide, prepare_around, recover, targets
from ..prune.blocks.merging import merge, reduce
from ..prune.blocks.pruning import finish, finish_learned, original_likeness
from ..prune.blocks.request import Request
from ..prune.blocks.sample import finer, refuse_hidden, sample_of
from ..prune.blocks.scoring import score
from ..prune.blocks.tuning import EPOCHS, TUNED, cut, tune
from ..prune.by_blocks import request_of
from ..prune.context import JobContext
from ..prune.door import check_files
from ..prune.options import PruneOptions
from ..prune.pipeline import run
from ..prune.recipes.by_blocks import Goal, LearnedByBlocks, MergedByBlocks
from ..scene.camera import Camera
from ..system.errors import SceneError
from ..system.option_kinds import default_of
from ..views.camera_files import load_cameras
from ..views.dataset import HOLDOUT, load_dataset
from ..views.rig import place_rig
from .option_parser import options_from

OF_METHODS = ("lambda_f", "iterations", "recovery", "schedule", "min_contribution")  # options


def large(words: argparse.Namespace) -> dict[str, Any]:
    """Does one step, or all. Raises SplatError."""
    library.set_threads(words.threads)
    steps = {
        "divide": _divide,
        "score": _score,
        "reduce": _reduce,
        "merge": _merge,
        "decide": _decide,
        "cut": _cut,
        "tune": _tune,
        "finish": _finish,
    }
    return (steps | {"prune": _prune})[words.action](words)


def as_text(words: argparse.Namespace, result: dict[str, Any]) -> str:
    if words.action == "divide":
        return (
            f"{result['count']:,} Gaussians in {result['blocks']} blocks, {result['views']} views; saved"
            f" {result['work']}"
        )
    if words.action == "score":
        return result["scores"]
    if words.action in ("reduce", "merge", "decide", "cut", "tune"):
        return f"{result['blocks']} blocks done in {result['work']}"
    before, after = result["before"], result["after"]
    measure = f"the photographs, the original {before['psnr']:.2f} dB" if "psnr" in before else "the original"
    merged = (
        f" ({result['psnr_merged']:.2f} dB before fine-tuning)" if result["psnr_merged"] is not None else ""
    )
    psnr = result["psnr"]  # NaN without views that are held out
    against = "" if math.isnan(psnr) else f"; PSNR {psnr:.2f} dB against {measure}{merged}"
    lines = [
        f"kept {after['count']:,} of {before['count']:,} Gaussians"
        f" ({after['count'] / before['count']:.1%}){against}; saved {result['out']}"
    ]
    for level in result.get("levels", ()):
        lines.append(
            f"level {level['share']:g}: {level['count']:,} Gaussians, PSNR {level['psnr']:.2f} dB; saved"
            f" {level['out']}"
        )
    return "\n".join([*lines, *result["notes"]])


def _prune(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
    goal, request = (
        Goal(words.target_count or 0, words.target or 0.0, words.max_drop or 0.0, words.levels),
        _request(words),
    )
    if request is None and not (goal.count or goal.share or goal.max_drop):
        raise SceneError("how many Gaussians stay is not given: add --target, --target-count or --max-drop")
    if request is not None and (words.steps is not None or goal.levels):
        raise SceneError(
            "--tuning-steps and --levels are for removals and merges: leave them out, or --method"
        )
    if words.resume and request is None:
        raise SceneError(
            "--resume is for methods that decide on photographs: removals and merges begin again"
        )
    messages = Messages(words.messages)
    job = JobContext(words.out, resume=words.resume, part=messages.progress)
    more: dict[str, Any] = {"work": words.work, "block": words.block}
    views = lambda: (*_views(words), list[str]())
    if request is not None:
        return run(LearnedByBlocks(words.scene, job, goal, views, request=request, **more))
    return run(MergedByBlocks(words.scene, job, goal, views, steps=words.steps, **more))


def _request(words: argparse.Namespace) -> Request | None:
    """What is asked of a method on photographs. Raises SceneError for options that do not go together."""
    if words.method:
        if not words.colmap:
            raise SceneError("--method decides on photographs: add --data, or leave it out")
        request = request_of(options_from(PruneOptions, words))
        request.dataset()  # raises before anything is written
        return request
    given = [
        name
        for name in OF_METHODS
        if getattr(words, name, None) not in (None, default_of(PruneOptions, name))
    ]
    if given:
        raise SceneError(
            f"--{given[0].replace('_', '-')} is for methods that decide on photographs: add --method, or"
            " leave it out"
        )
    return None


def _divide(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
    refuse_foreign(words.work)
    request, (scored, measured) = _request(words), _views(words)
    prepare(words.work, scored, measured, request)
    divided = divide(words.scene.absolute(), words.work, words.block, _told(words, "divide"))
    return {
        "work": str(words.work),
        "count": divided.count,
        "blocks": len(divided.blocks),
        "views": len(scored),
    }


def _score(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    return {
        "scores": str(
            score(divided, scored_views(words.work), words.part, words.parts, _told(words, "score"))
        )
    }


def _reduce(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    reduce(divided, scored_views(words.work))
    return {"work": str(words.work), "blocks": len(divided.blocks)}


def _merge(words: argparse.Namespace) -> dict[str, Any]:
    divided, tell = Divided.read(words.work), _told(words, "merge")
    numbers = range(len(divided.blocks))[words.part :: words.parts]
    for place, number in enumerate(numbers):
        tell(f"block {number}", place / len(numbers))
        merge(divided, number)
    return {"work": str(words.work), "blocks": len(numbers)}


def _decide(words: argparse.Namespace) -> dict[str, Any]:
    divided, request, goal = (
        Divided.read(words.work),
        Request.read(words.work),
        Goal(words.target_count or 0, words.target or 0.0),
    )
    if request is None:
        raise SceneError(
            f"{words.work}: was divided without --method, so no method decides: merge and cut it"
        )
    wanted = goal.number(divided.count) if goal.count or goal.share else 0
    plan, dataset, targets_of = request.plan(), request.dataset(), targets(divided, wanted)
    numbers = range(len(divided.blocks))[words.part :: words.parts]
    for number in numbers:
        decide(divided, number, dataset, plan, targets_of[number], _told(words, "decide"))
    return {"work": str(words.work), "blocks": len(numbers)}


def _cut(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    if Request.read(words.work) is not None:
        prepare_around(divided, _told(words, "cut"))
        return {"work": str(words.work), "blocks": len(divided.blocks), "count": divided.count}
    goal = Goal(words.target_count or 0, words.target or 0.0)
    if not (goal.count or goal.share):
        raise SceneError("how many Gaussians stay is not given: add --target or --target-count")
    left = cut(divided, scored_views(words.work), goal.number(divided.count), _told(words, "cut"))
    return {"work": str(words.work), "blocks": len(left.blocks), "count": left.count}


def _tune(words: argparse.Namespace) -> dict[str, Any]:
    divided, cameras, request = Divided.read(words.work), scored_views(words.work), Request.read(words.work)
    if request is not None:
        return _recover(words, divided, request)
    steps = EPOCHS * len(cameras) if words.steps is None else words.steps
    if not steps:
        clear(words.work / TUNED)  # no steps: remove what an earlier call has tuned
    numbers = range(len(divided.blocks))[words.part :: words.parts] if steps else range(0)
    for number in numbers:
        tune(divided, number, cameras, steps, _told(words, "tune"))
    return {"work": str(words.work), "blocks": len(numbers)}


def _recover(words: argparse.Namespace, divided: Divided, request: Request) -> dict[str, Any]:
    if words.steps is not None:
        raise SceneError(
            "--tuning-steps is for removals and merges: leave it out; --recovery of svrgs large divide gives"
            " the steps of a method"
        )
    numbers, plan, dataset = (
        range(len(divided.blocks) if request.recovery else 0)[words.part :: words.parts],
        request.plan(),
        request.dataset(),
    )
    for number in numbers:
        recover(divided, number, dataset, plan, _told(words, "recover"))
    return {"work": str(words.work), "blocks": len(numbers)}


def _finish(words: argparse.Namespace) -> dict[str, Any]:
    divided, request = Divided.read(words.work), Request.read(words.work)
    check_files(divided.source, [words.out])
    told = functools.partial(_told, words)
    if request is not None:
        result = finish_learned(divided, request, request.dataset(), words.out, told)
    else:
        result = finish(divided, original_likeness(divided, told), words.out, told)
    return result | {"views": len(scored_views(words.work))}


def _views(words: argparse.Namespace) -> tuple[list[Camera], list[Camera]]:
    """The views that are scored, and those on which the result is measured: given, or placed. Raises
    SceneError."""
    if words.colmap:
        dataset = load_dataset(words.colmap, words.images or None, holdout=words.holdout, cameras_only=True)
        scored, measured = (
            [dataset.cameras[k] for k in indices] for indices in (dataset.train_indices, dataset.test_indices)
        )
    elif words.cameras:
        cameras = load_cameras(words.cameras)
        scored, measured = (
            [camera for k, camera in enumerate(cameras) if (k % HOLDOUT == 0) is held_out]
            for held_out in (False, True)
        )
    else:
        _told(words, "rig")("looks for places of cameras", 0.0)
        scene, enlarged = sample_of(words.scene)
        rig = place_rig(scene, enlarged=enlarged)
        refuse_hidden(scene, rig.cameras, words.scene)
        scored, measured = finer(rig.cameras), rig.held_out
    if not scored:
        raise SceneError("one view is held out for the test, and no other is there: give at least two")
    return scored, measured


def _told(words: argparse.Namespace, step: str) -> Callable[[str, float], None]:
    """Reports progress of a step."""
    messages = Messages(words.messages)
    return lambda text, share: messages.progress(f"{step}: {text}", share)
