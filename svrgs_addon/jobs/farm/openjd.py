"""A farm job as a bundle of Open Job Description: template.json, and values of its parameters and the folders
it needs, as deadline-cloud submits them.

openjd/captures.json is the template. Of a job, it gets what its tasks need of a worker.
"""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from ...files.atomic import write_json
from .farm_job import FarmJob

TEMPLATE = Path(__file__).parent / "openjd" / "captures.json"
MEMORY = "amount.worker.memory"  # MiB
MIB, STEP = 1 << 20, 512  # memory is asked for in steps of so many MiB


def write_bundle(job: FarmJob, name: str, memory: int):
    """Writes the bundle into the folder of the job. name: of the job, as engines show it. memory: bytes that
    a task needs. Raises SceneError."""
    write_json(job.folder / "template.json", template(memory), indented=True)
    values = {
        "JobName": name,
        "JobFolder": str(job.folder),
        "Captures": str(job.root),
        "LastTask": len(job.tasks) - 1,
    }
    parameters = [{"name": key, "value": value} for key, value in values.items()]
    write_json(job.folder / "parameter_values.json", {"parameterValues": parameters}, indented=True)
    folders = {"inputs": {"directories": [str(job.root)]}, "outputs": {"directories": [str(job.folder)]}}
    write_json(job.folder / "asset_references.json", {"assetReferences": folders}, indented=True)


def template(memory: int) -> dict[str, Any]:
    """The template for tasks that need so many bytes of memory."""
    found = json.loads(TEMPLATE.read_text("utf-8"))
    for amount in found["steps"][0]["hostRequirements"]["amounts"]:
        if amount["name"] == MEMORY:
            amount["min"] = -(-memory // (STEP * MIB)) * STEP
    return found
