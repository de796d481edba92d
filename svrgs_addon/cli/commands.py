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

Words = argparse.Namespace  # as parsed


def info(words: Words) -> int:
    facts = registry.describe(words.scene)
    return _print(facts, words, "\n".join(f"{name:12} {value}" for name, value in facts.items()))


def render(words: Words) -> int:
    from .render_views import render_views

    _set_threads(words)
    saved = render_views(words)
    return _print(
        {"files": [str(path) for path in saved]}, words, "\n".join(f"Saved: '{path}'" for path in saved)
    )


def train(words: Words) -> int:
    from ..prune.pipeline import train_scene

    result = train_scene(options_from(TrainOptions, words))
    return _print(result, words, _figures(result))


def prune(words: Words) -> int:
    from ..jobs.worker import run_in_child
    from ..prune.pipeline import prune_scene
    from ..prune.plans import method_of
    from . import batch_list

    options = options_from(PruneOptions, words, out=None, report=None)
    method_of(options)  # raises for an unknown method once, not for each scene
    items = batch_list.expand(words.scenes, words.colmap, words.out, words.report, options.levels)
    if len(items) == 1 and not words.batch:
        result = prune_scene(_of_item(options, items[0], words.report))
        return _print(result, words, _figures(result))
    failed = stopped = False
    for item in items:
        line = {"scene": str(item.scene), "out": str(item.out)}
        if item.out.exists() and not words.overwrite and not batch_list.same_file(item.out, item.scene):
            line["skipped"] = (
                "the output exists"
                if all(level.exists() for level in item.levels)
                else "the output exists, not all its levels: add --overwrite"
            )
        else:
            status, result = run_in_child(_of_item(options, item, words.report and words.report / item.name))
            line, failed, stopped = {**line, **result}, failed or status != 0, status == STOPPED
        print(json.dumps(plain(line)), flush=True)
        if stopped:
            raise Cancelled
    return 1 if failed else 0


def _of_item(options: PruneOptions, item: Item, report: Path | None) -> PruneOptions:
    """The options of the job of one scene."""
    return replace(options, scene=item.scene, colmap=item.colmap, out=item.out, report=report)


def select(words: Words) -> int:
    from .select_gaussians import as_text, select_gaussians

    _set_threads(words)
    result = select_gaussians(words)
    return _print(result, words, as_text(result))


def convert(words: Words) -> int:
    from .convert_scenes import as_text, convert_scenes

    failed = False
    for line in convert_scenes(words):
        _print(line, words, as_text(line))
        failed = failed or "error" in line
    return 1 if failed else 0


def rig(words: Words) -> int:
    from .place_cameras import as_text, place_cameras

    _set_threads(words)
    result = place_cameras(words)
    return _print(result, words, as_text(result))


def evaluate(words: Words) -> int:
    from ..prune.blocks.block_rasterizer import opened
    from ..prune.plans import dataset_of
    from ..render.metrics import load_lpips
    from ..render.metrics.evaluate import evaluate as measure
    from ..render.metrics.evaluate import refuse_unseen, split_indices

    _set_threads(words)
    registry.check_readable(words.scene)
    # each photograph is read once
    dataset = dataset_of(options_from(DatasetOptions, words, image_memory=0.0))
    lpips, reason = load_lpips(words.lpips_weights)
    views = split_indices(dataset, words.split)
    needed = functools.partial(
        memory.measuring,
        cameras=[dataset.cameras[i] for i in views],
        kept_photographs=0,
        lpips=lpips is not None,
    )
    with opened(words.scene, "measuring", needed) as (scene, rasterizer):
        refuse_unseen(scene, dataset.cameras, str(words.scene))
        result = measure(scene, dataset, views, rasterizer, lpips)
    result |= {"bytes": registry.size_on_disk(words.scene), "notes": list(dataset.notes)}
    return _print(result, words, _figures(result, reason))


def compare(words: Words) -> int:
    from .compare_scenes import compare_scenes

    _set_threads(words)
    result = compare_scenes(words)
    return _print(
        result,
        words,
        "\n".join(
            [
                *(f"{name}: {_figures(result[name])}" for name in ("a", "b")),
                *result["notes"],
                result["report"],
            ]
        ),
    )


def methods(words: Words) -> int:
    from .method_list import as_text, method_list

    found = method_list()
    return _print({"methods": found}, words, as_text(found))


def farm(words: Words) -> int:
    from .farm_commands import as_text
    from .farm_commands import farm as run

    result = run(words)
    return _print(result, words, as_text(words, result))


def large(words: Words) -> int:
    from .large_scenes import as_text
    from .large_scenes import large as run

    result = run(words)
    return _print(result, words, as_text(words, result))


def bench(words: Words) -> int:
    from ..system.errors import SceneError
    from ..system.packages import is_installed, load

    if not is_installed("svrgs_bench"):
        raise SceneError(
            "svrgs bench is not part of the extension: use a checkout after make setup, or install the wheel"
        )
    result = load("svrgs_bench.run", "svrgs bench").bench(words)
    return _print(
        result, words, "" if words.json else load("svrgs_bench.text", "svrgs bench").as_text(result)
    )


COMMANDS: dict[str, Callable[[Words], int]] = {
    "info": info, "render": render, "train": train, "prune": prune, "select": select, "convert": convert,
    "rig": rig, "eval": evaluate, "compare": compare, "methods": methods, "farm": farm, "large": large,
    "bench": bench,
}  # fmt: skip


def _set_threads(words: Words):
    from ..native import library

    library.set_threads(words.threads)


def _figures(result: dict, lpips_missing: str = "") -> str:
    """The figures of a result as text."""
    parts = [f"{result['count']:,} Gaussians"]
    if "psnr" in result:  # not of a scene whose own pictures are the measure
        parts += [f"PSNR {result['psnr']:.2f} dB", f"SSIM {result['ssim']:.4f}", f"FLIP {result['flip']:.4f}"]
    if result.get("lpips") is not None:
        parts.append(f"LPIPS {result['lpips']:.4f}")
    parts.append(memory.size_text(result["bytes"]))
    if result.get("ms_per_frame") is not None:
        parts.append(f"{result['ms_per_frame']:.1f} ms per frame")
    before = result.get("before")
    # the quick way measures against the original itself
    measured = before if before and "psnr" in before else None
    lines = ([f"before  {_figures(measured)}"] if measured else []) + [
        ("after   " if measured else "") + ", ".join(parts)
    ]
    if before and not measured:
        lines.append(f"kept {result['count'] / before['count']:.1%} of the Gaussians")
    if measured:
        lines.append(
            f"kept {result['count'] / measured['count']:.1%} of the Gaussians at"
            f" {result['psnr'] - measured['psnr']:+.2f} dB"
        )
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


def _print(result: dict, words: Words, text: str) -> int:
    print(
        json.dumps(plain(result)) if words.json else "\n".join(map(printable, text.split("\n"))), flush=True
    )
    return 0
