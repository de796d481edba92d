"""A farm job for Flamenco 3, whose job type is flamenco/svrgs_prune.js. The manager takes flamenco.json: POST
/api/v3/jobs."""

from __future__ import annotations

from ...files.atomic import write_json
from ...system.here import MACOS, WINDOWS
from .farm_job import FarmJob

TYPE, PRIORITY = "svrgs-prune", 50  # the manager names a type after its file, with - for _


def write_submission(job: FarmJob, name: str):
    """Writes flamenco.json into the folder of the job. Raises SceneError."""
    settings = {
        "job_folder": str(job.folder),
        "captures": str(job.root),
        "last_task": len(job.tasks) - 1,
        "tasks_per_chunk": 1,
        "svrgs": "svrgs",
    }
    platform = "windows" if WINDOWS else "darwin" if MACOS else "linux"
    submission = {"name": name, "type": TYPE, "priority": PRIORITY, "submitter_platform": platform}
    write_json(job.folder / "flamenco.json", submission | {"settings": settings}, indented=True)
