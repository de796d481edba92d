"""Checkpoints of a run: one folder per checkpoint, with arrays.npz and manifest.json.

The manifest is written last and holds the digest of the arrays and of itself. A folder whose digests do not
match is not a checkpoint.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import logging
import shutil
from dataclasses import asdict
from operator import attrgetter
from pathlib import Path

import numpy as np

from ..files.atomic import check_space, write_arrays, write_json
from ..files.digests import sha256
from ..scene.gaussians import PARAMETERS
from ..system.errors import OtherRun, SceneError
from ..views.dataset import Dataset
from .averaging import Average
from .densify import Statistics
from .exposure import Exposures
from .model import Model
from .plan import Plan
from .poses import Poses
from .recovery_pruning import RecoveryPruning
from .run import Curves, Run
from .strength_controller import StrengthController

SCHEMA = 12
KEPT = 2  # number of checkpoints that are kept
_PARTS = ("values", "moments")
# of Run, as they are
_NUMBERS = ("iteration", "initial_count", "unordered", "target", "loss", "nonfinite", "held_back", "seconds")


def save(run: Run, folder: Path, identity: str, time: dict | None = None) -> Path:
    """Writes the state of the run to folder/<iteration> and deletes all checkpoints but the newest two.
    Returns the new folder.

    identity: digest of settings and inputs, compared by restore(). time: the plan of a job with a time limit,
    for newest_manifest(). Raises SceneError if the checkpoint cannot be written; the earlier checkpoints then
    stay.
    """
    target = folder / f"{run.iteration:07d}"
    try:
        _write(run, target, identity, time)
    except SceneError:
        if read_manifest(target) is None:
            shutil.rmtree(target, ignore_errors=True)
            _delete_if_empty(folder)
        raise
    for old in _folders(folder)[:-KEPT]:
        shutil.rmtree(old, ignore_errors=True)
    return target


def _write(run: Run, target: Path, identity: str, time: dict | None):
    arrays = {f"{part}.{name}": array for part in _PARTS for name, array in getattr(run.model, part).items()}
    arrays |= {f"average.{name}": array for name, array in run.average.values.items()}
    arrays["origin"] = run.model.origin
    for name, fitted in (("exposure", run.exposures), ("poses", run.poses)):
        if fitted:
            arrays |= {f"{name}.{part}": array for part, array in vars(fitted).items()}
    for name in ("statistics.total", "statistics.views", "views.losses", "views.left_out"):
        arrays[name] = attrgetter(name)(run)
    check_space(target / "arrays.npz", sum(array.nbytes for array in arrays.values()))
    write_arrays(target / "arrays.npz", arrays)
    manifest = {
        "schema": SCHEMA,
        "identity": identity,
        "time": time,
        "sha256": sha256(target / "arrays.npz"),
        **{name: getattr(run, name) for name in _NUMBERS},
        "epoch": [run.views.epoch, run.views.position],
        "averaged": run.average.samples,
        "method": run.method.state(),
        "controller": asdict(run.controller) if run.controller else None,
        "recovery_pruning": asdict(run.recovery_pruning) if run.recovery_pruning else None,
        "curves": asdict(run.curves),
    }
    manifest["digest"] = text_digest(manifest)
    write_json(target / "manifest.json", manifest)


def identity_of(start: Model, dataset: Dataset, plan: Plan, engine: str) -> str:
    """Digest of plan, engine, scene, cameras, photographs: a resumed run has the same. Raises SceneError."""
    digest = hashlib.sha256(
        repr((plan, engine, dataset.train_indices, start.metadata["antialiased"])).encode()
    )
    for name in PARAMETERS:
        digest.update(np.ascontiguousarray(getattr(start, name)).data)
    for part in dataset.inputs():
        digest.update(part)
    return digest.hexdigest()


def restore(run: Run, folder: Path, identity: str) -> bool:
    """Restores the run from the newest valid checkpoint. Returns False if there is none. Raises FormatError
    if it is of another run. A damaged checkpoint is deleted, with a warning, and the one before it is
    tried."""
    for candidate in reversed(_folders(folder)):
        manifest = read_manifest(candidate)
        if manifest is None:
            logging.warning(
                "checkpoint %s is damaged or of another version: the one before it is tried", candidate
            )
            # else it would stay the newest, and save() would delete new ones instead
            shutil.rmtree(candidate, ignore_errors=True)
            continue
        if manifest["identity"] != identity:
            raise OtherRun(
                f"{candidate}: this checkpoint is of a run with other settings or inputs; delete {folder} to"
                " start again"
            )
        _apply(run, candidate, manifest)
        return True
    return False


def newest_manifest(folder: Path) -> dict | None:
    """The manifest of the newest valid checkpoint in the folder; None if there is none."""
    return next(filter(None, map(read_manifest, reversed(_folders(folder)))), None)


def delete_all(folder: Path):
    """Deletes every checkpoint in the folder, and the folder if it is empty then."""
    for old in _folders(folder):
        shutil.rmtree(old, ignore_errors=True)
    _delete_if_empty(folder)


def _delete_if_empty(folder: Path):
    with contextlib.suppress(OSError):
        folder.rmdir()


def _apply(run: Run, folder: Path, manifest: dict):
    with np.load(folder / "arrays.npz", allow_pickle=False) as arrays:
        parts = {
            part: {name.split(".", 1)[1]: arrays[name] for name in arrays if name.startswith(part + ".")}
            for part in (*_PARTS, "average", "exposure", "poses")
        }
        run.model.values, run.model.moments = (parts[part] for part in _PARTS)
        run.average = Average(parts["average"], manifest["averaged"])
        run.exposures = Exposures(**parts["exposure"]) if parts["exposure"] else None
        if parts["poses"]:
            run.put_back_poses(Poses(**parts["poses"]))
        run.model.origin = arrays["origin"]
        run.statistics = Statistics(run.model.count)
        run.statistics.total, run.statistics.views = arrays["statistics.total"], arrays["statistics.views"]
        run.views.losses, run.views.left_out = arrays["views.losses"], arrays["views.left_out"]
    run.views.epoch, run.views.position = manifest["epoch"]
    for name in _NUMBERS:
        setattr(run, name, manifest[name])
    run.method.restore(manifest["method"])
    run.controller = StrengthController(**manifest["controller"]) if manifest["controller"] else None
    pruning = manifest["recovery_pruning"]
    run.recovery_pruning = RecoveryPruning(**pruning) if pruning else None
    run.curves = Curves(**manifest["curves"])


def _folders(folder: Path) -> list[Path]:
    return sorted(path for path in folder.glob("[0-9]" * 7) if path.is_dir())


def read_manifest(folder: Path) -> dict | None:
    """The manifest of a checkpoint, without its digest; None if that is incomplete or was changed."""
    try:
        manifest = json.loads((folder / "manifest.json").read_bytes())
        own = manifest.pop("digest")
        if (
            manifest["schema"] == SCHEMA
            and own == text_digest(manifest)
            and manifest["sha256"] == sha256(folder / "arrays.npz")
        ):
            return manifest
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RecursionError):
        pass
    return None


def text_digest(manifest: dict) -> str:
    """SHA-256 of the manifest as JSON. The manifest must not contain its digest yet."""
    return hashlib.sha256(json.dumps(manifest).encode()).hexdigest()
