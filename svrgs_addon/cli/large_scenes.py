"""`svrgs large`: scenes larger than memory. `prune` does all of it; `divide`, `score`, `reduce`, `merge`, `cut`, `tune` and `finish` are its steps, for a
farm."""

from __future__ import annotations

import argparse
import contextlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import native
from ..camera import Camera, evenly
from ..errors import SceneError
from ..farm.engine_messages import Messages
from ..files.atomic import check_writable, reserved
from ..files.registry import format_to_read, format_to_write, refuse_input
from ..large.blocks import Divided, clear, divide
from ..large.merging import merge, reduce
from ..large.pruning import likeness, pictures_of, result_of, write_joined
from ..large.scoring import score
from ..large.tuning import CUT, EPOCHS, MIXED, TUNED, best_share, cut, mixed, tune, tuned_blocks
from ..photographs.camera_files import load_cameras
from ..photographs.cameras_json import write_cameras_json
from ..photographs.dataset import HOLDOUT, load_dataset

TRAIN, TEST, RESULT = "scored_views.json", "measured_views.json", "result"  # in the folder of the blocks
MEASURED = 8  # views on which the result is measured, at most


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
    return f"kept {after['count']:,} of {before['count']:,} Gaussians ({after['count'] / before['count']:.1%}){against}; saved {result['out']}"


def _prune(words: argparse.Namespace) -> dict[str, Any]:
    words.work = words.work or words.out.with_name(words.out.name + ".blocks")
    _check_out(words.out, words.scene)
    with reserved(words.out):
        _refuse_work(words.work)
        words.part, words.parts = 0, 1
        try:
            for step in (_divide, _score, _reduce, _merge, _cut, _tune):
                step(words)
            return _finish(words)
        finally:
            _remove(words.work)


def _remove(work: Path):
    """Removes what was written into the folder of the blocks, and the folder, if nothing else is in it."""
    for folder in (work / RESULT, work / CUT, work / TUNED, work / MIXED, work):
        clear(folder)
        for name in (TRAIN, TEST):
            (folder / name).unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()


def _refuse_work(work: Path):
    """Raises SceneError for a folder with other things than blocks; those of a run that was killed are replaced."""
    if work.exists() and not (work.is_dir() and (not any(work.iterdir()) or (work / TRAIN).is_file())):
        raise SceneError(f"{work}: is not empty, and holds no blocks; name another folder with --work")


def _divide(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
    _refuse_work(words.work)
    train, test = _cameras(words)
    words.work.mkdir(parents=True, exist_ok=True)
    write_cameras_json(words.work / TRAIN, train)
    write_cameras_json(words.work / TEST, test)
    divided = divide(words.scene.absolute(), words.work, words.block, _told(words, "divide"))
    return {"work": str(words.work), "count": divided.count, "blocks": len(divided.blocks), "views": len(train)}


def _score(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    return {"scores": str(score(divided, load_cameras(words.work / TRAIN), words.part, words.parts, _told(words, "score")))}


def _reduce(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    reduce(divided, load_cameras(words.work / TRAIN))
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
    left = cut(divided, load_cameras(words.work / TRAIN), words.target_count or max(1, round(words.target * divided.count)), _told(words, "cut"))
    return {"work": str(words.work), "blocks": len(left.blocks), "count": left.count}


def _tune(words: argparse.Namespace) -> dict[str, Any]:
    divided, cameras = Divided.read(words.work), load_cameras(words.work / TRAIN)
    steps = EPOCHS * len(cameras) if words.steps is None else words.steps
    if not steps:
        clear(words.work / TUNED)  # what was tuned before does not count then
    numbers = range(len(divided.blocks))[words.part :: words.parts] if steps else range(0)
    for number in numbers:
        tune(divided, number, cameras, steps, _told(words, "tune"))
    return {"work": str(words.work), "blocks": len(numbers)}


def _finish(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    _check_out(words.out, divided.source)
    left, tuned, test = Divided.read(words.work / CUT), tuned_blocks(divided), evenly(load_cameras(words.work / TEST), MEASURED)
    originals = list(pictures_of(divided, test, _told(words, "look")))
    facts: dict[str, float | None] = {"psnr_merged": None, "tuned_share": 0.0}
    if tuned:
        share = best_share(divided, tuned, lambda scene: likeness(scene, test, originals, _told(words, "compare"))) if test else 1.0
        facts = {"psnr_merged": likeness(left, test, originals), "tuned_share": share}
        left = mixed(divided, tuned, share)
    write_joined(left, words.out)
    written = divide(words.out, words.work / RESULT, tell=_told(words, "read"))
    facts["psnr"] = likeness(written, test, originals, _told(words, "measure"))
    return result_of(divided, written, facts, len(test), words.out)


def _check_out(out: Path, source: Path):
    format_to_write(out)
    check_writable(out)
    refuse_input(out, source)


def _cameras(words: argparse.Namespace) -> tuple[list[Camera], list[Camera]]:
    """The views that are scored, and those on which the result is measured. Raises SplatError."""
    if words.colmap:
        dataset = load_dataset(words.colmap, holdout=HOLDOUT, cameras_only=True)
        groups = ([dataset.cameras[k] for k in indices] for indices in (dataset.train_indices, dataset.test_indices))
    else:
        cameras = load_cameras(words.cameras)
        groups = ([camera for k, camera in enumerate(cameras) if (k % HOLDOUT == 0) is held_out] for held_out in (False, True))
    train, test = groups
    if not train:
        raise SceneError("one view is held out for the test, and no other is there: give at least two")
    return train, test


def _told(words: argparse.Namespace, step: str) -> Callable[[str, float], None]:
    messages = Messages(words.messages)
    return lambda text, share: messages.progress(f"{step}: {text}", share)
