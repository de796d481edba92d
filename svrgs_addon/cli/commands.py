"""The commands: each takes the parsed arguments, writes files, prints a result and returns the exit status.

A command imports its modules itself, so that `svrgs info` starts at once.
"""

from __future__ import annotations

import argparse
import functools
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from ..files import registry
from ..prune.options import DatasetOptions, PruneOptions, TrainOptions
from ..system import memory
from ..system.errors import Cancelled
from ..system.exit_status import STOPPED, plain, printable
from .option_parser import options_from

if TYPE_CHECKING:
    from .batch_list import Item


def info(args: argparse.Namespace) -> int:
    facts = registry.describe(args.scene)
    return _print(facts, args, "\n".join(f"{name:12} {value}" for name, value in facts.items()))


def render(args: argparse.Namespace) -> int:
    from .render_views import render_views

    _set_threads(args)
    saved = render_views(args)
    text = "\n".join(f"Saved: '{path}'" for path in saved)
    return _print({"files": [str(path) for path in saved]}, args, text)


def train(args: argparse.Namespace) -> int:
    from ..prune.pipeline import train_scene

    result = train_scene(options_from(TrainOptions, args))
    return _print(result, args, _figures(result))


def prune(args: argparse.Namespace) -> int:
    from ..jobs.worker import run_in_child
    from ..prune.pipeline import prune_scene
    from ..prune.plans import method_of
    from . import batch_list

    options = options_from(PruneOptions, args, out=None, report=None)
    method_of(options)  # raises for an unknown method once, not for each scene
    items = batch_list.expand(args.scenes, args.data, args.out, args.report, options.levels)
    if len(items) == 1 and not args.batch:
        result = prune_scene(_of_item(options, items[0], args.report))
        return _print(result, args, _figures(result))
    failed = stopped = False
    for item in items:
        line = {"scene": str(item.scene), "out": str(item.out)}
        if item.out.exists() and not args.overwrite and not batch_list.same_file(item.out, item.scene):
            line["skipped"] = "the output exists"
            if not all(level.exists() for level in item.levels):
                line["skipped"] += ", not all its levels: add --overwrite"
        else:
            status, result = run_in_child(_of_item(options, item, args.report and args.report / item.name))
            line, failed, stopped = {**line, **result}, failed or status != 0, status == STOPPED
        print(json.dumps(plain(line)), flush=True)
        if stopped:
            raise Cancelled
    return 1 if failed else 0


def _of_item(options: PruneOptions, item: Item, report: Path | None) -> PruneOptions:
    """The options of the job of one scene."""
    return replace(options, scene=item.scene, data=item.data, out=item.out, report=report)


def select(args: argparse.Namespace) -> int:
    from .select_gaussians import as_text, select_gaussians

    _set_threads(args)
    result = select_gaussians(args)
    return _print(result, args, as_text(result))


def convert(args: argparse.Namespace) -> int:
    from .convert_scenes import as_text, convert_scenes

    failed = False
    for line in convert_scenes(args):
        _print(line, args, as_text(line))
        failed = failed or "error" in line
    return 1 if failed else 0


def rig(args: argparse.Namespace) -> int:
    from .place_cameras import as_text, place_cameras

    _set_threads(args)
    result = place_cameras(args)
    return _print(result, args, as_text(result))


def evaluate(args: argparse.Namespace) -> int:
    from ..prune.blocks.block_rasterizer import opened
    from ..prune.plans import dataset_of
    from ..render.metrics import load_lpips
    from ..render.metrics.evaluate import evaluate as measure
    from ..render.metrics.evaluate import refuse_unseen, split_indices
    from ..render.metrics.lpips import measurable

    _set_threads(args)
    registry.check_readable(args.scene)
    # each photograph is read once
    dataset = dataset_of(options_from(DatasetOptions, args, image_memory=0.0))
    views = split_indices(dataset, args.split)
    cameras = [dataset.cameras[i] for i in views]
    asked = args.lpips_weights is not None or args.lpips_authors
    lpips, reason = measurable(load_lpips(args.lpips_weights), cameras, asked)
    needed = functools.partial(memory.measuring, cameras=cameras, kept_photographs=0, lpips=lpips is not None)
    with opened(args.scene, "measuring", needed) as (scene, rasterizer):
        refuse_unseen(scene, dataset.cameras, str(args.scene))
        result = measure(scene, dataset, views, rasterizer, lpips, args.matched, args.aligned)
        if args.lpips_authors and lpips is not None:
            other, _ = load_lpips(args.lpips_weights, "authors")
            result["lpips_authors"] = measure(scene, dataset, views, rasterizer, other)["lpips"]
    result |= {"bytes": registry.size_on_disk(args.scene), "notes": list(dataset.notes)}
    return _print(result, args, _figures(result, reason))


def view(args: argparse.Namespace) -> int:
    from .view_scenes import view_scenes

    _set_threads(args)
    view_scenes(args)
    return 0


def compare(args: argparse.Namespace) -> int:
    from .compare_scenes import compare_scenes

    _set_threads(args)
    result = compare_scenes(args)
    figures = (f"{name}: {_figures(result[name])}" for name in ("a", "b"))
    return _print(result, args, "\n".join([*figures, *result["notes"], result["report"]]))


def methods(args: argparse.Namespace) -> int:
    from .method_list import as_text, method_list

    found = method_list()
    return _print({"methods": found}, args, as_text(found))


def farm(args: argparse.Namespace) -> int:
    from .farm_commands import as_text
    from .farm_commands import farm as run

    result = run(args)
    return _print(result, args, as_text(args, result))


def large(args: argparse.Namespace) -> int:
    from .large_scenes import as_text
    from .large_scenes import large as run

    result = run(args)
    return _print(result, args, as_text(args, result))


def bench(args: argparse.Namespace) -> int:
    from ..system.errors import SceneError
    from ..system.packages import is_installed, load

    if not is_installed("svrgs_bench"):
        raise SceneError(
            "svrgs bench is not part of the extension: use a checkout after make setup, or install the wheel"
        )
    result = load("svrgs_bench.run", "svrgs bench").bench(args)
    return _print(result, args, "" if args.json else load("svrgs_bench.text", "svrgs bench").as_text(result))


COMMANDS: dict[str, Callable[[argparse.Namespace], int]] = {
    "info": info, "render": render, "train": train, "prune": prune, "select": select, "convert": convert,
    "view": view, "rig": rig, "eval": evaluate, "compare": compare, "methods": methods, "farm": farm,
    "large": large, "bench": bench,
}  # fmt: skip


# of a result, as text; what is None was not measured
FIGURES = {
    "count": "{:,} Gaussians",
    "psnr": "PSNR {:.2f} dB",
    "ssim": "SSIM {:.4f}",
    "flip": "FLIP {:.4f}",
    "psnr_matched": "PSNR in the photographs' colours {:.2f} dB",
    "psnr_aligned": "PSNR after alignment {:.2f} dB",
    "lpips": "LPIPS {:.4f}",
    "lpips_authors": "LPIPS of colours in [-1, 1] {:.4f}",
    "bytes": "{}",
    "ms_per_frame": "{:.1f} ms per frame",
}


def _set_threads(args: argparse.Namespace):
    from ..native import library

    library.set_threads(args.threads)


def _figures(result: dict, lpips_missing: str = "") -> str:
    """The figures of a result as text."""
    facts = result | {"bytes": memory.size_text(result["bytes"])}
    known = (text.format(facts[name]) for name, text in FIGURES.items() if facts.get(name) is not None)
    before, figures = result.get("before"), ", ".join(known)
    if not before:
        lines = [figures]
    elif "psnr" in before:
        change = f"{result['psnr'] - before['psnr']:+.2f} dB"
        lines = [f"before  {_figures(before)}", f"after   {figures}", f"{_kept(result)} at {change}"]
    else:  # the quick way measures against the original itself
        lines = [figures, _kept(result)]
    lines += [
        f"level {level['share']:g}: {_figures(level)}; saved {level['out']}"
        for level in result.get("levels", ())
    ]
    lines += result.get("notes", ())
    if result.get("densifications_held_back"):
        lines.append(
            f"{result['densifications_held_back']} densifications added nothing: memory was too short"
        )
    if "seconds" in result:
        lines.append(f"{result['seconds']:.0f} s; saved {result['out']}")
    return "\n".join(lines + ([f"LPIPS left out: {lpips_missing}"] if lpips_missing else []))


def _kept(result: dict) -> str:
    return f"kept {result['count'] / result['before']['count']:.1%} of the Gaussians"


def _print(result: dict, args: argparse.Namespace, text: str) -> int:
    print(json.dumps(plain(result)) if args.json else "\n".join(map(printable, text.split("\n"))), flush=True)
    return 0
