"""A background job that trains: run, paused, resumed; its folder, honest and hostile."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from job_checks import at_work, follow
from svrgs_addon.files.ply import read_ply
from svrgs_addon.jobs.job_folder import PRUNE, TRAIN, JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.system.errors import FormatError, SceneError

SHORT, MEDIUM = 80, 800  # steps


def create(path: Path, tiny, iterations: int) -> JobFolder:
    return JobFolder.create_training(path, {"data": str(tiny.folder), "iterations": iterations}, "tiny")


@pytest.fixture(scope="module")
def done(tiny, tmp_path_factory) -> tuple[Job, list[dict]]:
    """A finished job and what it said."""
    job = Job(create(tmp_path_factory.mktemp("trained") / "job", tiny, SHORT))
    job.start()
    heard = follow(job)
    assert job.state == "done", (job.facts, job.folder.log_tail())
    return job, heard


def test_a_job_trains_and_leaves_its_splat(done, tiny, svrgs, tmp_path):
    job, heard = done
    progress = [message for message in heard if message["type"] == "PROGRESS"]
    assert progress[-1]["iteration"] == progress[-1]["total"] == SHORT and progress[-1]["psnr"] > 5
    assert any(message["type"] == "PREVIEW" for message in heard)
    assert job.folder.metrics()["iteration"][-1] == SHORT
    result = job.folder.result()
    assert result["count"] == read_ply(job.folder.output).count
    assert result["out"] == str(job.folder / "trained.ply") == str(job.folder.output)
    words = ("--iterations", SHORT, "--quiet", "--out", tmp_path / "shell.ply")
    assert svrgs("train", "--data", tiny.folder, *words).status == 0
    # what the command line does
    assert (tmp_path / "shell.ply").read_bytes() == job.folder.output.read_bytes()
    assert not (job.folder / "recovered.ply").exists() and not (job.folder / "recovered.ply.job").exists()


@pytest.mark.slow
def test_a_stopped_job_goes_on_to_the_same_bytes(tiny, tmp_path, jobs):
    found = []
    for name in ("whole", "stopped"):
        job = Job(create(tmp_path / name, tiny, MEDIUM))
        jobs.append(job)
        job.start()
        if name == "stopped":
            follow(job, at_work)
            job.stop()
            follow(job)
            assert job.state == "stopped" and 5 < job.facts["iteration"] < MEDIUM
            job.start()
        follow(job)
        assert job.state == "done", (job.facts, job.folder.log_tail())
        found.append(job.folder.output.read_bytes())
    assert found[0] == found[1]


def test_what_a_job_needs_is_said(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, SHORT))
    (tmp_path / "none").mkdir()
    request = json.loads((job.folder / "job.json").read_text())
    (job.folder / "job.json").write_text(
        json.dumps(request | {"options": {"data": str(tmp_path / "none"), "iterations": 5}})
    )
    jobs.append(job)
    job.start()
    follow(job)
    assert job.state == "failed" and "none: holds no COLMAP model" in job.facts["text"]


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"iterations": 5},
        {"data": "x", "out": "/etc/x"},
        {"data": "x", "target_count": "all"},
        {"data": "x", "max_drop": 1.0},
    ],
)
def test_unusable_options(tmp_path, options):
    with pytest.raises(SceneError):
        JobFolder.create_training(tmp_path / "job", options)
    assert not (tmp_path / "job").exists()


@pytest.mark.parametrize(
    "changes",
    [{"kind": "paint"}, {"kind": ["train"]}, {"kind": None}, {"kind": PRUNE}, {"count": -1}, {"count": None}],
)
def test_hostile_requests(tiny, tmp_path, changes):
    folder = create(tmp_path / "job", tiny, SHORT)
    assert folder.kind == TRAIN
    request = json.loads((folder / "job.json").read_text())
    (folder / "job.json").write_text(json.dumps(request | changes))
    with pytest.raises(FormatError, match=r"job\.json"):
        folder.request()


def test_discarding_removes_the_job_and_nothing_else(done, tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, SHORT))
    jobs.append(job)
    job.start()
    follow(job)
    (job.folder / "mine.txt").write_text("mine")
    job.folder.discard()
    assert [path.name for path in job.folder.path.iterdir()] == ["mine.txt"]
    assert job.state == "done" and job.folder.state() == {"state": "missing"}
