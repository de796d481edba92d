"""Jobs of the tests: made, followed, of several lengths."""

from __future__ import annotations

import time
from pathlib import Path

from svrgs_addon.files.ply import read_ply
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job

ROOT = Path(__file__).resolve().parents[1]
SHORT = {"iterations": 40, "recovery": 20, "lambda_f": 1e-2, "target": 0.5}
# long enough to be met at work
MEDIUM = {"iterations": 800, "recovery": 200, "lambda_f": 1e-2, "target": 0.4}
LONG = {"iterations": 20_000, "recovery": 0, "lambda_f": 1e-5, "min_contribution": 0.0}


def create(path: Path, tiny, **options) -> JobFolder:
    return JobFolder.create(path, read_ply(tiny.splat), {"data": str(tiny.folder), **options}, "tiny")


def follow(job: Job, until=lambda job: not job.running, seconds: float = 60) -> list[dict]:
    """Polls until the condition holds; every message on the way."""
    heard, end = [], time.monotonic() + seconds
    while not until(job):
        heard += job.poll()
        assert time.monotonic() < end, (job.facts, job.folder.log_tail())
        time.sleep(0.02)
    return heard


def at_work(job: Job) -> bool:
    return job.facts.get("iteration", 0) > 5 or not job.running
