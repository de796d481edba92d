"""A farm job for its engines, and what its tasks need of a worker.

Open Job Description takes a bundle: template.json, and values of its parameters and the folders it needs, as
deadline-cloud submits them. openjd/captures.json is the template; of a job, it gets what its tasks need.

Flamenco 3, whose job type is flamenco/svrgs_prune.js, takes flamenco.json: POST /api/v3/jobs of its manager.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import numpy as np

from ...files.atomic import write_json
from ...files.registry import describe, size_on_disk
from ...prune.options import PruneOptions
from ...scene.camera import Camera
from ...scene.gaussians import SH_COEFFICIENTS
from ...system import memory
from ...system.here import MACOS, WINDOWS
from ...views.dataset import load_dataset
from .farm_job import FarmJob

TEMPLATE = Path(__file__).parent / "openjd" / "captures.json"
MEMORY = "amount.worker.memory"  # MiB
MIB, STEP = 1 << 20, 512  # memory is asked for in steps of so many MiB
TYPE, PRIORITY = "svrgs-prune", 50  # Flamenco's manager names a type after its file, with - for _
PROGRAM = 500 << 20  # bytes of the program and its libraries
PLACED, SIDE = 64, 1024  # without photographs: cameras, and pixels of a side of their pictures, at most about


def write_engine_files(job: FarmJob, needed: int):
    """Writes the files of all engines into the folder of the job, which names it. needed: bytes of memory
    that a task needs. Raises SceneError."""
    folder, last = job.folder, len(job.tasks) - 1
    places = {"JobFolder": str(folder), "Captures": str(job.root)}
    parameters = {"JobName": folder.name, **places, "LastTask": last}
    values = [{"name": name, "value": value} for name, value in parameters.items()]
    folders = {"inputs": {"directories": [str(job.root)]}, "outputs": {"directories": [str(folder)]}}
    write_json(folder / "template.json", template(needed), indented=True)
    write_json(folder / "parameter_values.json", {"parameterValues": values}, indented=True)
    write_json(folder / "asset_references.json", {"assetReferences": folders}, indented=True)
    platform = "windows" if WINDOWS else "darwin" if MACOS else "linux"
    submission = {"name": folder.name, "type": TYPE, "priority": PRIORITY, "submitter_platform": platform}
    settings = {
        "job_folder": str(folder),
        "captures": str(job.root),
        "last_task": last,
        "tasks_per_chunk": 1,
        "svrgs": "svrgs",
    }
    write_json(folder / "flamenco.json", submission | {"settings": settings}, indented=True)


def template(needed: int) -> dict[str, Any]:
    """The template for tasks that need so many bytes of memory."""
    found = json.loads(TEMPLATE.read_text("utf-8"))
    for amount in found["steps"][0]["hostRequirements"]["amounts"]:
        if amount["name"] == MEMORY:
            amount["min"] = -(-needed // (STEP * MIB)) * STEP
    return found


def memory_of(options: PruneOptions) -> int:
    """Bytes of memory that pruning with these options needs. Raises SplatError."""
    assert options.scene is not None
    facts = describe(options.scene)
    count, coefficients = facts["count"], SH_COEFFICIENTS[facts["sh_degree"]]
    if options.data:
        cameras = load_dataset(
            options.data, options.images or None, holdout=options.holdout, cameras_only=True
        ).cameras
    else:
        cameras = PLACED * [Camera(np.eye(4), np.diag([SIDE, SIDE, 1.0]), SIDE, SIDE)]
    tuned = memory.tuning(count, coefficients, cameras, int(options.image_memory * 1e9))
    merged = 0 if options.data and not options.quick else memory.decimating(count, coefficients, cameras)
    return PROGRAM + max(tuned, merged, memory.reading(size_on_disk(options.scene)))
