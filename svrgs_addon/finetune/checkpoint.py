"""Checkpoints: arrays.npz first, manifest.json last. A folder without a manifest that fits its arrays, and itself, is not a checkpoint."""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import shutil
from dataclasses import asdict
from pathlib import Path

import numpy as np

from ..errors import FormatError, SceneError
from ..files.atomic import atomic_write, check_writable
from ..files.npz import write_arrays
from .densify import Statistics
from .recovery_pruning import RecoveryPruning
from .run import Curves, Run
from .strength_controller import StrengthController

SCHEMA = 10
KEPT = 2  # newest checkpoints kept
_PARTS = ("values", "moments")


def save(run: Run, folder: Path, identity: str) -> Path:
    """Writes the run's state to folder/<iteration>, then forgets all but the newest two. identity: settings and inputs.

    Raises SceneError where it cannot be written; what there was before stays.
    """
    target = folder / f"{run.iteration:07d}"
    try:
        _write(run, target, identity)
    except SceneError:
        if read_manifest(target) is None:
            shutil.rmtree(target, ignore_errors=True)
            _forget_if_empty(folder)
        raise
    for old in _folders(folder)[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def _write(run: Run, target: Path, identity: str):
    arrays = {f"{part}.{name}": array for part in _PARTS for name, array in getattr(run.model, part).items()}
    arrays |= {"origin": run.model.origin, "statistics.total": run.statistics.total, "statistics.views": run.statistics.views}
    arrays |= {"views.losses": run.views.losses, "views.left_out": run.views.left_out}
    check_writable(target / "arrays.npz", sum(array.nbytes for array in arrays.values()))
    write_arrays(target / "arrays.npz", arrays)
    manifest = {
        "schema": SCHEMA,
        "identity": identity,
        "sha256": _digest(target / "arrays.npz"),
        "iteration": run.iteration,
        "epoch": [run.views.epoch, run.views.position],
        "initial_count": run.initial_count,
        "unordered": run.unordered,
        "target": run.target,
        "method": run.method.state(),
        "controller": asdict(run.controller) if run.controller else None,
        "recovery_pruning": asdict(run.recovery_pruning) if run.recovery_pruning else None,
        "loss": run.loss,
        "nonfinite": run.nonfinite,
        "held_back": run.held_back,
        "seconds": run.seconds,
        "curves": asdict(run.curves),
    }
    manifest["digest"] = text_digest(manifest)
    with atomic_write(target / "manifest.json") as file:
        file.write(json.dumps(manifest).encode())


def restore(run: Run, folder: Path, identity: str) -> bool:
    """Puts the newest whole checkpoint's state into the run. False: there is none. FormatError: it is of another run."""
    for candidate in reversed(_folders(folder)):
        manifest = read_manifest(candidate)
        if manifest is None:
            logging.warning("%s is damaged or of another version: trying the checkpoint before it", candidate)
            shutil.rmtree(candidate, ignore_errors=True)  # it must not outlive, as the newest, those written from here on
            continue
        if manifest["identity"] != identity:
            raise FormatError(f"{candidate}: was written by a run with other settings or inputs; delete {folder} to start anew")
        _apply(run, candidate, manifest)
        return True
    return False


def forget(folder: Path):
    """Removes every checkpoint, and the folder if nothing else is in it."""
    for old in _folders(folder):
        shutil.rmtree(old, ignore_errors=True)
    _forget_if_empty(folder)


def _forget_if_empty(folder: Path):
    with contextlib.suppress(OSError):
        folder.rmdir()


def _apply(run: Run, folder: Path, manifest: dict):
    with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
        for part in _PARTS:
            loaded = {name.split(".", 1)[1]: arrays[name] for name in arrays if name.startswith(part + ".")}
            setattr(run.model, part, loaded)
        run.model.origin = arrays["origin"]
        run.statistics = Statistics(run.model.count)
        run.statistics.total, run.statistics.views = arrays["statistics.total"], arrays["statistics.views"]
        run.views.losses, run.views.left_out = arrays["views.losses"], arrays["views.left_out"]
    run.views.epoch, run.views.position = manifest["epoch"]
    run.iteration, run.initial_count, run.unordered = manifest["iteration"], manifest["initial_count"], manifest["unordered"]
    run.target = manifest["target"]
    run.method.restore(manifest["method"])
    run.controller = StrengthController(**manifest["controller"]) if manifest["controller"] else None
    run.recovery_pruning = RecoveryPruning(**manifest["recovery_pruning"]) if manifest["recovery_pruning"] else None
    run.loss, run.seconds = manifest["loss"], manifest["seconds"]
    run.nonfinite, run.held_back = manifest["nonfinite"], manifest["held_back"]
    run.curves = Curves(**manifest["curves"])


def _folders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("[0-9]" * 7) if path.is_dir())


def read_manifest(folder: Path) -> dict | None:
    """What save() wrote of the checkpoint in `folder`; None where it is not whole, or was changed since."""
    try:
        manifest = json.loads((folder / "manifest.json").read_bytes())
        own = manifest.pop("digest")
        if manifest["schema"] == SCHEMA and own == text_digest(manifest) and manifest["sha256"] == _digest(folder / "arrays.npz"):
            return manifest
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        pass
    return None


def text_digest(manifest: dict) -> str:
    """Of the manifest as JSON, without its own digest."""
    return hashlib.sha256(json.dumps(manifest).encode()).hexdigest()


def _digest(path: Path) -> str:
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()
