"""`svrgs large`: scenes larger than memory. `prune` does all of it; `divide`, `score`, `reduce`, `merge` and `finish` are its steps, for a farm."""

from __future__ import annotations

import argparse
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

from .. import native
from ..camera import Camera, evenly
from ..errors import SceneError
from ..farm.engine_messages import Messages
from ..files.atomic import check_writable, reserved
from ..files.registry import format_to_read, format_to_write, refuse_input
from ..large.blocks import Divided, divide
from ..large.merging import counts, merge, reduce
from ..large.pruning import likeness, result_of, write_merged
from ..large.scoring import score
from ..photographs.camera_files import load_cameras
from ..photographs.cameras_json import write_cameras_json
from ..photographs.dataset import HOLDOUT, load_dataset

TRAIN, TEST = "cameras.json", "test_cameras.json"  # in the folder of the blocks
MEASURED = 8  # views on which the result is measured, at most


def large(words: argparse.Namespace) -> dict[str, Any]:
    """Does one step, or all. Raises SplatError."""
    native.set_threads(words.threads)
    return {"prune": _prune, "divide": _divide, "score": _score, "reduce": _reduce, "merge": _merge, "finish": _finish}[words.action](words)


def as_text(words: argparse.Namespace, result: dict[str, Any]) -> str:
    if words.action == "divide":
        return f"{result['count']:,} Gaussians in {result['blocks']} blocks, {result['views']} views; saved {result['work']}"
    if words.action == "score":
        return result["scores"]
    if words.action in ("reduce", "merge"):
        return f"{result['blocks']} blocks done in {result['work']}"
    before, after = result["before"], result["after"]
    against = f"; PSNR {result['psnr']:.2f} dB against the original" if result["views"] else ""
    return f"kept {after['count']:,} of {before['count']:,} Gaussians ({after['count'] / before['count']:.1%}){against}; saved {result['out']}"


def _prune(words: argparse.Namespace) -> dict[str, Any]:
    words.work = words.work or words.out.with_name(words.out.name + ".blocks")
    _check_out(words.out, words.scene)
    if words.work.exists() and any(words.work.iterdir()) and not (words.work / TRAIN).is_file():  # blocks of a run that was killed are replaced
        raise SceneError(f"{words.work}: is not empty, and holds no blocks; name another folder with --work")
    with reserved(words.out):
        try:
            _divide(words)
            words.part, words.parts = 0, 1
            for step in (_score, _reduce, _merge):
                step(words)
            return _finish(words)
        finally:
            shutil.rmtree(words.work, ignore_errors=True)


def _divide(words: argparse.Namespace) -> dict[str, Any]:
    format_to_read(words.scene)
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


def _finish(words: argparse.Namespace) -> dict[str, Any]:
    divided = Divided.read(words.work)
    _check_out(words.out, divided.source)
    kept = counts(divided, words.target_count or max(1, round(words.target * divided.count)))
    write_merged(divided, kept, words.out, _told(words, "write"))
    result = divide(words.out, words.work / "result", tell=_told(words, "read"))
    test = evenly(load_cameras(words.work / TEST), MEASURED)
    return result_of(divided, result, likeness(result, divided, test, _told(words, "measure")), len(test), words.out)


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
