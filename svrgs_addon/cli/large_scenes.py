"""`svrgs large`: scenes larger than memory. `prune` does all of it; `divide`, `score`, `reduce`, `merge`,
`decide`, `cut`, `tune` and `finish` are its steps, for a farm."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from functools import partial
from typing import Any

from ..jobs.farm.engine_messages import Messages
from ..native import library
from ..prune import job_views
from ..prune.belonging import check_explained, check_seen, seen_of
from ..prune.blocks.block_rasterizer import BlockRasterizer
from ..prune.blocks.divided import Divided, clear, divide
from ..prune.blocks.folder import prepare, refuse_foreign, remove, scored_views
from ..prune.blocks.learning import decide, prepare_around, recover, targets
from ..prune.blocks.merging import merge, reduce, with_seen
from ..prune.blocks.pruning import finish, finish_learned, original_likeness
from ..prune.blocks.request import Request
from ..prune.blocks.sample import sample_of
from ..prune.blocks.scoring import score
from ..prune.blocks.tuning import EPOCHS, TUNED, cut, tune
from ..prune.by_blocks import OF_METHODS
from ..prune.context import JobContext
from ..prune.door import check_files, check_view_options, check_visible, given, outputs
from ..prune.job_views import Views
from ..prune.likeness import PhotographLikeness
from ..prune.options import PruneOptions
from ..prune.pipeline import run
from ..prune.recipes.by_blocks import Goal, LearnedByBlocks, MergedByBlocks
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from ..system.option_kinds import flag_of
from .option_parser import options_from


def large(args: argparse.Namespace) -> dict[str, Any]:
    """Does one step, or all. Raises SplatError."""
    library.set_threads(args.threads)
    steps = {
        "prune": _prune, "divide": _divide, "score": _score, "reduce": _reduce, "merge": _merge,
        "decide": _decide, "cut": _cut, "tune": _tune, "finish": _finish,
    }  # fmt: skip
    result = steps[args.action](args)
    return result if args.action in ("prune", "score", "finish") else {"work": str(args.work)} | result


def as_text(args: argparse.Namespace, result: dict[str, Any]) -> str:
    if args.action == "divide":
        return (
            f"{result['count']:,} Gaussians in {result['blocks']} blocks, {result['views']} views; saved"
            f" {result['work']}"
        )
    if args.action == "score":
        return result["scores"]
    if args.action in ("reduce", "merge", "decide", "cut", "tune"):
        return f"{result['blocks']} blocks done in {result['work']}"
    before, after, psnr = result["before"], result["after"], result["psnr"]
    against = ""
    if psnr is not None:
        against = f"; PSNR {psnr:.2f} dB against the "
        against += f"photographs, the original {before['psnr']:.2f} dB" if "psnr" in before else "original"
        if result["psnr_merged"] is not None:
            against += f" ({result['psnr_merged']:.2f} dB before fine-tuning)"
    lines = [
        f"kept {after['count']:,} of {before['count']:,} Gaussians"
        f" ({after['count'] / before['count']:.1%}){against}; saved {result['out']}"
    ]
    for level in result.get("levels", ()):
        psnr = "" if level["psnr"] is None else f", PSNR {level['psnr']:.2f} dB"
        lines.append(f"level {level['share']:g}: {level['count']:,} Gaussians{psnr}; saved {level['out']}")
    return "\n".join([*lines, *result["notes"]])


def _prune(args: argparse.Namespace) -> dict[str, Any]:
    request, goal = _request(args), _goal(args)
    if request is None and not (goal.count or goal.share or goal.max_drop):
        raise SceneError("how many Gaussians stay is not given: add --target, --target-count or --max-drop")
    if request is not None and (args.steps is not None or goal.levels):
        raise SceneError(
            "--tuning-steps and --levels are for removals and merges: leave them out, or --method"
        )
    if args.resume and request is None:
        raise SceneError(
            "--resume is for methods that decide on photographs: removals and merges begin again"
        )
    job = JobContext(args.out, resume=args.resume, force=args.force, part=Messages(args.messages).progress)
    views, more = partial(_views, args), {"work": args.work, "block": args.block}
    if request is not None:
        return run(LearnedByBlocks(args.scene, job, goal, views, request=request, **more))
    return run(MergedByBlocks(args.scene, job, goal, views, steps=args.steps, **more))


def _request(args: argparse.Namespace) -> Request | None:
    """What is asked of a method on photographs. Raises SceneError for options that do not go together."""
    options = options_from(PruneOptions, args)
    check_view_options(options)
    if args.method:
        if not args.data:
            raise SceneError("--method decides on photographs: add --data, or leave it out")
        return Request.of(options)
    if others := [name for name in given(options) if name in OF_METHODS]:
        raise SceneError(
            f"{flag_of(PruneOptions, others[0])} is for methods that decide on photographs: add --method, or"
            " leave it out"
        )
    return None


def _divide(args: argparse.Namespace) -> dict[str, Any]:
    check_files(args.scene, [])
    refuse_foreign(args.work)
    request = _request(args)
    dataset = None if request is None else request.dataset()  # raises before anything is written
    sample, enlarged = sample_of(args.scene)
    check_visible(sample, str(args.scene))
    scored, measured, *_ = _views(args, sample, enlarged)
    if request is None:
        check_seen(seen_of(sample, scored), str(args.scene), args.force)
    prepare(args.work, scored, measured, request)
    divided = divide(args.scene.absolute(), args.work, args.block, _progress_of(args, "divide"))
    if dataset is not None:
        try:
            check_explained(divided, dataset, str(args.scene), args.force, BlockRasterizer())
        except SceneError:
            remove(args.work)
            raise
    return {"count": divided.count, "blocks": len(divided.blocks), "views": len(scored)}


def _score(args: argparse.Namespace) -> dict[str, Any]:
    divided, views = Divided.read(args.work), scored_views(args.work)
    return {"scores": str(score(divided, views, args.part, args.parts, _progress_of(args, "score")))}


def _reduce(args: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(args.work)
    reduce(divided, scored_views(args.work))
    return {"blocks": len(divided.blocks)}


def _merge(args: argparse.Namespace) -> dict[str, Any]:
    divided, progress = Divided.read(args.work), _progress_of(args, "merge")
    numbers = _numbers(args, divided)
    for place, number in enumerate(numbers):
        progress(f"block {number}", place / len(numbers))
        merge(divided, number)
    return {"blocks": len(numbers)}


def _decide(args: argparse.Namespace) -> dict[str, Any]:
    divided, request, goal = Divided.read(args.work), Request.read(args.work), _goal(args)
    if request is None:
        raise SceneError(f"{args.work}: was divided without --method, so no method decides: merge and cut it")
    wanted = goal.number(divided.count) if goal.count or goal.share else 0
    plan, dataset, targets_of = request.plan(), request.dataset(), targets(divided, wanted)
    numbers = _numbers(args, divided)
    for number in numbers:
        decide(divided, number, dataset, plan, targets_of[number], _progress_of(args, "decide"))
    return {"blocks": len(numbers)}


def _cut(args: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(args.work)
    if Request.read(args.work) is not None:
        prepare_around(divided, _progress_of(args, "cut"))
        return {"blocks": len(divided.blocks), "count": divided.count}
    goal = _goal(args)
    if not (goal.count or goal.share):
        raise SceneError("how many Gaussians stay is not given: add --target or --target-count")
    left = cut(divided, scored_views(args.work), goal.number(divided.count), _progress_of(args, "cut"))
    return {"blocks": len(left.blocks), "count": left.count}


def _tune(args: argparse.Namespace) -> dict[str, Any]:
    divided, cameras, request = Divided.read(args.work), scored_views(args.work), Request.read(args.work)
    if request is not None:
        return _recover(args, divided, request)
    steps = EPOCHS * len(cameras) if args.steps is None else args.steps
    if not steps:
        clear(args.work / TUNED)  # no steps: remove what an earlier call has tuned
    numbers = _numbers(args, divided) if steps else range(0)
    for number in numbers:
        tune(divided, number, cameras, steps, _progress_of(args, "tune"))
    return {"blocks": len(numbers)}


def _recover(args: argparse.Namespace, divided: Divided, request: Request) -> dict[str, Any]:
    if args.steps is not None:
        raise SceneError(
            "--tuning-steps is for removals and merges: leave it out; --recovery of svrgs large divide gives"
            " the steps of a method"
        )
    numbers = _numbers(args, divided) if request.options.recovery else range(0)
    plan, dataset = request.plan(), request.dataset()
    for number in numbers:
        recover(divided, number, dataset, plan, _progress_of(args, "recover"))
    return {"blocks": len(numbers)}


def _finish(args: argparse.Namespace) -> dict[str, Any]:
    divided, request = Divided.read(args.work), Request.read(args.work)
    progress_of = partial(_progress_of, args)
    with outputs(divided.source, [args.out]):
        if request is not None:
            photographs = PhotographLikeness(request.dataset(), BlockRasterizer, progress_of)
            result = finish_learned(divided, photographs, request, args.out, progress_of)
        else:
            likeness = original_likeness(divided, progress_of)
            result = with_seen(divided, finish(divided, likeness, args.out, progress_of))
    return result | {"views": len(scored_views(args.work))}


def _goal(args: argparse.Namespace) -> Goal:
    """How many Gaussians stay. Only `prune` takes a drop and levels."""
    drop, levels = getattr(args, "max_drop", None), getattr(args, "levels", ())
    return Goal(args.target_count or 0, args.target or 0.0, drop or 0.0, levels)


def _numbers(args: argparse.Namespace, divided: Divided) -> range:
    """The blocks of the part of the work."""
    return range(len(divided.blocks))[args.part :: args.parts]


def _views(args: argparse.Namespace, sample: Scene, enlarged: float) -> Views:
    """The views of a sample of the scene, and a message before some are placed."""
    options = options_from(PruneOptions, args)
    if not (options.data or options.cameras):
        _progress_of(args, "rig")("looks for places of cameras", 0.0)
    return job_views.large(options, sample, enlarged)


def _progress_of(args: argparse.Namespace, step: str) -> Callable[[str, float], None]:
    """Reports progress of a step."""
    messages = Messages(args.messages)
    return lambda text, share: messages.progress(f"{step}: {text}", share)
