"""What each command does: options in, files and a result out. A command imports what it alone needs, so that info starts at once."""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import Cancelled, SceneError
from ..exit_status import STOPPED, plain
from ..files import registry
from .arguments import MIN_CONTRIBUTION, RECOVERY

if TYPE_CHECKING:
    from .batch_list import Item

Options = argparse.Namespace


def info(options: Options) -> int:
    facts = registry.describe(options.scene)
    return _print(facts, options, "\n".join(f"{name:12} {value}" for name, value in facts.items()))


def render(options: Options) -> int:
    from .render_views import render_views

    _set_threads(options)
    saved = render_views(options)
    return _print({"files": [str(path) for path in saved]}, options, "\n".join(f"Saved: '{path}'" for path in saved))


def train(options: Options) -> int:
    from ..finetune.methods import method_named
    from ..finetune.plan import train_settings
    from ..finetune.settings import Densify
    from ..jobs import train_and_prune
    from ..jobs.stop_request import StopRequest

    _set_threads(options)
    method = _method(options)
    recovery = options.recovery if options.recovery is not None else RECOVERY * method_named(method).prunes
    settings = train_settings(
        method, options.iterations, recovery, lambda_f=options.lambda_f, lambda_m=options.lambda_m, seed=options.seed,
        full=not options.visible_mask, background=options.background, densify=Densify.within(options.iterations, options.densify_until),
        coarse_until=options.coarse_until, views_by_loss=options.views_by_loss, target=options.target_count or 0, share=options.target or 0.0,
        schedule=options.schedule,
    )  # fmt: skip
    job = _job(options)
    train_and_prune.check_outputs(job)
    dataset = _load(options, need_points=True)
    with StopRequest() as stop:
        result = train_and_prune.train(dataset, settings, replace(job, stop=stop), options.sh_degree)
    return _print(result, options, _figures(result))


def prune(options: Options) -> int:
    from ..jobs.worker import run_in_child
    from . import batch_list

    _method(options)  # one that does not exist is a matter of the command, not of each scene
    items = batch_list.expand(options.scenes, options.colmap, options.out, options.report)
    if len(items) == 1 and not options.batch:
        result = prune_one(argparse.Namespace(**_item_options(options, items[0], options.report)))
        return _print(result, options, _figures(result))
    failed = stopped = False
    for item in items:
        line = {"scene": str(item.scene), "out": str(item.out)}
        if item.out.exists() and not options.overwrite and item.out.resolve() != item.scene.resolve():
            line["skipped"] = "the output exists"
        else:
            status, result = run_in_child(_item_options(options, item, options.report and options.report / item.name))
            line, failed, stopped = {**line, **result}, failed or status != 0, status == STOPPED
        print(json.dumps(plain(line)), flush=True)
        if stopped:
            raise Cancelled
    return 1 if failed else 0


def _item_options(options: Options, item: Item, report: Path | None) -> dict:
    """The options of one scene's job."""
    rest = {name: value for name, value in vars(options).items() if name not in ("scenes", "command")}
    return {**rest, "scene": item.scene, "colmap": item.colmap, "out": item.out, "report": report}


def prune_one(options: Options, adapt: Callable = lambda job: job) -> dict:
    """One scene: options.scene, .colmap, .out, .report beside those of the command line; returns the JSON result.

    adapt: from the jobs.JobOptions of the command line to those the job is run with.
    """
    from ..finetune.plan import prune_settings
    from ..jobs import train_and_prune
    from ..jobs.stop_request import StopRequest

    _set_threads(options)
    if options.colmap is None:
        raise SceneError(f"{options.scene}: pruning needs the photographs it was trained on; give --colmap DIR")
    settings = prune_settings(
        _method(options), options.iterations, options.recovery, lambda_f=options.lambda_f, lambda_m=options.lambda_m, seed=options.seed,
        full=not options.visible_mask, background=tuple(options.background), target=_target(options), max_drop=options.max_drop,
        min_contribution=_min_contribution(options), views_by_loss=options.views_by_loss, schedule=options.schedule,
    )  # fmt: skip
    job = _job(options, options.report)
    train_and_prune.check_outputs(job)
    dataset = _load(options)
    with StopRequest() as stop:
        return train_and_prune.prune(options.scene, dataset, settings, adapt(replace(job, stop=stop)))


def _method(options: Options) -> str:
    """The method's name; SceneError where it does not exist, or --paper does not fit."""
    from ..finetune.methods import PAPER, method_named

    if options.method == PAPER:  # a name for results, not for requests
        raise SceneError(f"method '{PAPER}' is unknown: it is chosen by --method svr --paper")
    method_named(options.method)
    if options.paper and options.method != "svr":
        raise SceneError(f"--paper is the paper's form of method 'svr', not of '{options.method}'")
    return PAPER if options.paper else options.method


def _min_contribution(options: Options) -> float:
    from ..finetune.methods import method_named

    if options.min_contribution is not None:
        return options.min_contribution
    return MIN_CONTRIBUTION if method_named(_method(options)).first_cut else 0.0


def _target(options: Options) -> int:
    from ..finetune.methods import method_named

    if options.target_count is not None:
        return options.target_count
    share = options.target or (0.0 if options.max_drop else method_named(_method(options)).share)
    return max(1, round(share * registry.describe(options.scene)["count"])) if share else 0


def evaluate(options: Options) -> int:
    from ..metrics import load_lpips
    from ..metrics.evaluate import evaluate as measure
    from ..metrics.evaluate import refuse_unseen, split_indices
    from ..native import Rasterizer

    _set_threads(options)
    scene = registry.load_scene(options.scene).scene
    dataset = _load(options)
    refuse_unseen(scene, dataset.cameras, str(options.scene))
    lpips, reason = load_lpips(options.lpips_weights)
    result = measure(scene, dataset, split_indices(dataset, options.split), Rasterizer(), lpips)
    result["bytes"] = options.scene.stat().st_size
    return _print(result, options, _figures(result, reason))


def compare(options: Options) -> int:
    from ..report.compare import compare as run

    _set_threads(options)
    result = run(options.a, options.b, _load(options), options.out, options.lpips_weights)
    return _print(result, options, "\n".join(f"{name}: {_figures(result[name])}" for name in ("a", "b")) + f"\n{result['report']}")


def bench(options: Options) -> int:
    from ..bench.run import bench as run
    from ..bench.text import as_text

    result = run(options)
    return _print(result, options, "" if options.json else as_text(result))


COMMANDS: dict[str, Callable[[Options], int]] = {
    "info": info, "render": render, "train": train, "prune": prune, "eval": evaluate, "compare": compare, "bench": bench,
}  # fmt: skip


def _load(options: Options, need_points: bool = False):
    from ..photographs.dataset import load_dataset

    return load_dataset(
        options.colmap, options.images, holdout=options.holdout, background=tuple(options.background), need_points=need_points,
        memory_budget=int(options.image_memory * 1e9),
    )  # fmt: skip


def _job(options: Options, report: Path | None = None):
    from ..jobs.options import JobOptions
    from ..metrics import load_lpips
    from .progress import Reporter

    lpips, missing = load_lpips(options.lpips_weights)
    return JobOptions(options.out, report, options.resume, options.engine, lpips, missing, Reporter(options.quiet))


def _set_threads(options: Options):
    from .. import native

    native.set_threads(options.threads)


def _figures(result: dict, lpips_missing: str = "") -> str:
    """The figures of a result as people read them."""
    parts = [f"{result['count']:,} Gaussians", f"PSNR {result['psnr']:.2f} dB", f"SSIM {result['ssim']:.4f}", f"FLIP {result['flip']:.4f}"]
    if result.get("lpips") is not None:
        parts.append(f"LPIPS {result['lpips']:.4f}")
    parts += [f"{result['bytes'] / 1e6:.1f} MB", f"{result['ms_per_frame']:.1f} ms per frame"]
    before = result.get("before")
    lines = ([f"before  {_figures(before)}"] if before else []) + [("after   " if before else "") + ", ".join(parts)]
    if before:
        lines.append(f"kept {result['count'] / before['count']:.1%} of the Gaussians at {result['psnr'] - before['psnr']:+.2f} dB")
    if result.get("densifications_held_back"):
        lines.append(f"{result['densifications_held_back']} densifications added nothing: memory was too short")
    if "seconds" in result:
        lines.append(f"{result['seconds']:.0f} s; saved {result['out']}")
    return "\n".join(lines + ([f"LPIPS left out: {lpips_missing}"] if lpips_missing else []))


def _print(result: dict, options: Options, text: str) -> int:
    print(json.dumps(plain(result)) if options.json else text, flush=True)
    return 0
