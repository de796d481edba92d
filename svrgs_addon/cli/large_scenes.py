"""`svrgs large`: scenes larger than memory. `prune` does all of it; `divide`, `score`, `reduce`, `merge`, `cut`, `tune` and `finish` are its steps, for a
farm."""

from __future__ import annotations

import argparse
import functools
from collections.abc import Callable
from typing import Any

from .. import native
from ..camera import Camera
from ..errors import SceneError
from ..farm.engine_messages import Messages
from ..files.registry import format_to_read
from ..large.blocks import Divided, clear, divide
from ..large.folder import measured_views, prepare, refuse_foreign, scored_views
from ..large.likeness import Likeness
from ..large.merging import merge, reduce
from ..large.pruning import finish
from ..large.sample import finer, refuse_hidden, sample_of
from ..large.scoring import score
from ..large.tuning import EPOCHS, TUNED, cut, tune
from ..large.whole import Goal, check_out, prune_by_blocks
from ..photographs.camera_files import load_cameras
from ..photographs.dataset import HOLDOUT, load_dataset
from ..rig import place_rig


def large(words: argparse.Namespace) -> dict[str, Any]:
    """Does one step, or all. Raises SplatError."""
    native.set_threads(words.threads)
    steps = {"divide": _divide, "score": _score, "reduce": _reduce, "merge": _merge, "cut": _cut, "tune": _tune, "finish": _finish}
    return (steps | {"prune": _prune})[words.action](words)


def as_text(words: argparse.Namespace, result: dict[str, Any]) -> str:
    if words.action == "divide":
        return f"{result['count']:,} Gaussians in {result['blocks']} blocks, {result['views']} views; saved {result['work']}"
    if words.action == "score":
        return result["scores"]
    if words.action in ("reduce", "merge", "cut", "tune"):
        return f"{result['blocks']} blocks done in {result['work']}"
    before, after = result["before"], result["after"]
    merged = f" ({result['psnr_merged']:.2f} dB before fine-tuning)" if result["psnr_merged"] is not None else ""
    against = f"; PSNR {result['psnr']:.2f} dB against the original{merged}" if result["views"] else ""
    lines = [f"kept {after['count']:,} of {before['count']:,} Gaussians ({after['count'] / before['count']:.1%}){against}; saved {result['out']}"]
    for level in result.get("levels", ()):
        lines.append(f"level {level['share']:g}: {level['count']:,} Gaussians, PSNR {level['psnr']:.2f} dB; saved {level['out']}")
    return "\n".join([*lines, *result["notes"]])


def _prune(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
    told = functools.partial(_told, words)
    goal = Goal(words.target_count or 0, words.target or 0.0, words.max_drop or 0.0, words.levels)
    return prune_by_blocks(words.scene, words.out, functools.partial(_views, words), goal, words.steps, told, words.work, words.block)


def _divide(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
    refuse_foreign(words.work)
    scored, measured = _views(words)
    prepare(words.work, scored, measured)
    divided = divide(words.scene.absolute(), words.work, words.block, _told(words, "divide"))
    return {"work": str(words.work), "count": divided.count, "blocks": len(divided.blocks), "views": len(scored)}


def _score(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    return {"scores": str(score(divided, scored_views(words.work), words.part, words.parts, _told(words, "score")))}


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


def _cut(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    goal = Goal(words.target_count or 0, words.target or 0.0)
    left = cut(divided, scored_views(words.work), goal.number(divided.count), _told(words, "cut"))
    return {"work": str(words.work), "blocks": len(left.blocks), "count": left.count}


def _tune(words: argparse.Namespace) -> dict[str, Any]:
    divided, cameras = Divided.read(words.work), scored_views(words.work)
    steps = EPOCHS * len(cameras) if words.steps is None else words.steps
    if not steps:
        clear(words.work / TUNED)  # no steps: remove what an earlier call has tuned
    numbers = range(len(divided.blocks))[words.part :: words.parts] if steps else range(0)
    for number in numbers:
        tune(divided, number, cameras, steps, _told(words, "tune"))
    return {"work": str(words.work), "blocks": len(numbers)}


def _finish(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    check_out(words.out, divided.source)
    told = functools.partial(_told, words)
    return finish(divided, Likeness(divided, measured_views(words.work), told), words.out, told)


def _views(words: argparse.Namespace) -> tuple[list[Camera], list[Camera]]:
    """The views that are scored, and those on which the result is measured: given, or placed. Raises SceneError."""
    if words.colmap:
        dataset = load_dataset(words.colmap, holdout=HOLDOUT, cameras_only=True)
        scored, measured = ([dataset.cameras[k] for k in indices] for indices in (dataset.train_indices, dataset.test_indices))
    elif words.cameras:
        cameras = load_cameras(words.cameras)
        scored, measured = ([camera for k, camera in enumerate(cameras) if (k % HOLDOUT == 0) is held_out] for held_out in (False, True))
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
    messages = Messages(words.messages)
    return lambda text, share: messages.progress(f"{step}: {text}", share)
