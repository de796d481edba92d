"""A job in a process of its own: started, followed, paused, cancelled, killed, orphaned; its folder, honest and hostile."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from svrgs_addon.errors import FormatError, SceneError
from svrgs_addon.files.ply import read_ply
from svrgs_addon.jobs import job_folder as folders
from svrgs_addon.jobs import job_plot
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.jobs.options import RECOVERY

ROOT = Path(__file__).resolve().parents[1]
SHORT = {"iterations": 40, "recovery": 20, "lambda_f": 1e-2, "target": 0.5}
MEDIUM = {"iterations": 2400, "recovery": 600, "lambda_f": 1e-2, "target": 0.4}  # long enough to be met at work
LONG = {"iterations": 20_000, "recovery": 0, "lambda_f": 1e-5, "min_contribution": 0.0}


def create(path: Path, tiny, **options) -> JobFolder:
    return JobFolder.create(path, read_ply(tiny.splat), {"colmap": str(tiny.folder), **options}, "tiny")


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


@pytest.fixture
def jobs():
    """Collects jobs whose processes must not outlive the test."""
    started: list[Job] = []
    yield started
    for job in started:
        if job.running:
            job._process.kill()
            job._process.wait()


@pytest.fixture(scope="module")
def done(tiny, tmp_path_factory) -> tuple[Job, list[dict]]:
    """A finished job and what it said."""
    job = Job(create(tmp_path_factory.mktemp("done") / "job", tiny, **SHORT))
    job.start()
    heard = follow(job)
    assert job.state == "done", (job.facts, job.folder.log_tail())
    return job, heard


def test_a_job_reports_progress_and_leaves_its_result(done, tiny):
    job, heard = done
    progress = [message for message in heard if message["type"] == "PROGRESS"]
    assert progress and progress[-1]["iteration"] == progress[-1]["total"] == 60
    assert {"count", "psnr", "seconds_left", "phase"} <= set(progress[-1]) and progress[-1]["psnr"] > 10
    assert job.result["count"] == 125 and job.result["before"]["count"] == tiny_dataset.COUNT
    pruned = read_ply(job.folder / "pruned.ply")
    assert pruned.count == 125 and folders.ROW not in pruned.attributes
    assert job.result["bytes"] == (job.folder / "pruned.ply").stat().st_size
    assert job.result["before"]["bytes"] == tiny.splat.stat().st_size
    previews = [message["path"] for message in heard if message["type"] == "PREVIEW"]
    assert previews and all((job.folder / path).stat().st_size > 100 for path in previews)
    metrics = job.folder.metrics()
    assert metrics["iteration"][-1] == 60 and metrics["count"][-1] == 125 and np.isfinite(metrics["psnr"]).any()


def test_the_score_orders_the_source_as_the_job_did(done, tiny):
    job, _ = done
    kept, score = job.folder.arrays()
    assert kept.sum() == 125 and (score[kept] > 0.5).all() and (score[~kept] < 0.5).all() and (score >= 0).all()
    assert len(np.unique(score)) == tiny_dataset.COUNT, "any count can be asked for"
    faint = np.arange(tiny_dataset.COUNT) >= 2 * tiny_dataset.SEEN
    assert not kept[faint].any(), "what no view can show goes first"
    assert score[faint].max() < score[~faint & ~kept].max()
    pruned, source = read_ply(job.folder / "pruned.ply"), read_ply(tiny.splat)
    assert np.abs(pruned.means - source.means[kept]).max() < 0.2, "recovered Gaussians stay in the source's order, near where they were"


def test_cancel_is_answered_within_a_second_and_the_job_can_go_on(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    started = time.monotonic()
    job.cancel()
    follow(job)
    assert time.monotonic() - started < 1
    assert job.state == "cancelled" and job.folder.state()["state"] == "cancelled"
    job.start()
    assert not (job.folder / "cancel").exists()
    follow(job, at_work)
    assert job.state == "running"


def test_cancel_while_the_job_is_still_reading(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, lambda job: job.state == "running")
    job.cancel()
    follow(job, seconds=2)
    assert job.state == "cancelled"


def result_bytes(job: Job) -> list[bytes]:
    return [(job.folder / name).read_bytes() for name in ("pruned.ply", "kept.npy", "score.npy", "metrics.csv")]


@pytest.fixture(scope="module")
def undisturbed(tiny, tmp_path_factory) -> list[bytes]:
    """What a job of medium length leaves when nothing comes between."""
    job = Job(create(tmp_path_factory.mktemp("undisturbed") / "job", tiny, **MEDIUM))
    job.start()
    follow(job)
    assert job.state == "done", (job.facts, job.folder.log_tail())
    return result_bytes(job)


@pytest.mark.parametrize("pauses", [1, 3])
def test_paused_jobs_end_as_if_they_had_not_been(undisturbed, tiny, tmp_path, jobs, pauses):
    job = Job(create(tmp_path / "job", tiny, **MEDIUM))
    jobs.append(job)
    for k in range(pauses):
        job.start()
        follow(job, lambda job, k=k: job.facts.get("iteration", 0) > 400 * (k + 1) or not job.running)
        job.pause()
        follow(job)
        assert job.state == job.folder.state()["state"] == "paused"
        assert 400 * (k + 1) < job.folder.state()["iteration"] < 3000
    job.start()
    follow(job)
    assert job.state == "done", job.facts
    assert result_bytes(job) == undisturbed


def test_a_killed_job_is_interrupted_and_goes_on_to_the_same_bytes(undisturbed, tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **MEDIUM))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    os.kill(job._process.pid, signal.SIGKILL)
    follow(job)
    assert job.state == "interrupted" and "killed" in job.facts["text"]
    again = Job(JobFolder(job.folder.path))  # as after the file was opened again
    assert again.state == "interrupted"
    jobs.append(again)
    again.start()
    follow(again)
    assert result_bytes(again) == undisturbed


def test_a_job_whose_parent_dies_saves_a_checkpoint_and_ends(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **LONG)
    code = (
        "import sys, time\nfrom svrgs_addon.jobs.job_process import Job\nfrom svrgs_addon.jobs.job_folder import JobFolder\n"
        "job = Job(JobFolder(sys.argv[1]))\njob.start()\n"
        "while job.facts.get('iteration', 0) < 20:\n    job.poll()\n    time.sleep(0.02)\n"
        "print('working', flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen([sys.executable, "-c", code, str(folder.path)], cwd=ROOT, stdout=subprocess.PIPE) as parent:
        assert parent.stdout.readline() == b"working\n"
        child = folder.state()["pid"]
        parent.kill()
    end = time.monotonic() + 10
    while folder.state()["state"] != "interrupted" and time.monotonic() < end:
        time.sleep(0.05)
    assert json.loads((folder / "state.json").read_bytes())["state"] == "interrupted", "written by the job itself, not inferred"
    assert list((folder / "recovered.ply.job").glob("*/manifest.json"))
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert not Path(f"/proc/{child}").exists() or "Z" in Path(f"/proc/{child}/stat").read_text().split(")")[1][:3]


def test_a_job_without_a_sign_of_life_counts_as_interrupted(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **SHORT)
    folder.write_json("state.json", {"state": "running", "pid": 1})
    assert folder.state()["state"] == "running"
    past = time.time() - 2 * folders.STALE
    os.utime(folder / "state.json", (past, past))
    assert folder.state()["state"] == "interrupted"
    (folder / "state.json").write_bytes(b'{"state": "runn')
    assert folder.state()["state"] == "interrupted"
    assert JobFolder(tmp_path / "nothing").state()["state"] == "missing"


def test_a_vanished_dataset_is_one_sentence(tiny, tmp_path, jobs):
    folder = JobFolder.create(tmp_path / "job", read_ply(tiny.splat), {"colmap": str(tmp_path / "gone")})
    job = Job(folder)
    jobs.append(job)
    job.start()
    follow(job)
    assert job.state == "failed" and "gone" in job.facts["text"] and "\n" not in job.facts["text"]


def test_a_vanished_scene_is_one_sentence(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    (job.folder / "scene.ply").unlink()
    job.start()
    follow(job)
    assert job.state == "failed" and "scene.ply" in job.facts["text"]


def test_a_process_that_says_nothing_is_given_up(tiny, tmp_path, jobs, monkeypatch):
    monkeypatch.setattr("svrgs_addon.jobs.job_process.START_SECONDS", 0.0)
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    job.start()
    follow(job)
    assert job.state == "failed" and "did not start" in job.facts["text"]


def test_garbage_among_the_messages_is_passed_over(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    job.start()
    with open(job.folder / "messages.jsonl", "ab") as file:
        file.write(b'\xff\xfe not json\n[1, 2]\n{"type": 3}\n{"no": "type"}\n')
    follow(job)
    assert job.state == "done"


GOOD = {"schema": 1, "name": "a", "count": 3, "options": {"colmap": "somewhere"}}
HOSTILE = [
    b"", b"{", b"[]", b"null", b"[" * 100_000, json.dumps(GOOD | {"schema": 99}).encode(), json.dumps(GOOD | {"count": -1}).encode(),
    json.dumps(GOOD | {"count": True}).encode(), json.dumps(GOOD | {"name": 3}).encode(), json.dumps(GOOD | {"options": []}).encode(),
    *(json.dumps(GOOD | {"options": {"colmap": "x", **bad}}).encode() for bad in (
        {"out": "/etc/passwd"}, {"report": "/tmp/x"}, {"lpips_weights": "x"}, {"iterations": "3"}, {"iterations": 1.5}, {"seed": True},
        {"lambda_f": "nan"}, {"images": "a\nb"}, {"visible_mask": 1}, {"colmap": ""},
    )),
    json.dumps(GOOD | {"padding": "x" * folders.LARGEST_JSON}).encode(),
]  # fmt: skip


@pytest.mark.parametrize("content", HOSTILE, ids=range(len(HOSTILE)))
def test_a_hostile_request_is_refused(content, tmp_path):
    (tmp_path / "job.json").write_bytes(content)
    with pytest.raises(FormatError, match="job.json"):
        JobFolder(tmp_path).request()
    with pytest.raises(FormatError, match="job.json"):
        Job(JobFolder(tmp_path)).start()


def test_words_of_a_request_stay_values(tmp_path):
    (tmp_path / "job.json").write_text(json.dumps(GOOD | {"options": {"colmap": "--out=x", "images": "--overwrite", "visible_mask": True}}))
    options = JobFolder(tmp_path).options()
    assert (str(options.colmap), options.images, options.visible_mask) == ("--out=x", "--overwrite", True)
    assert options.out == tmp_path / "recovered.ply"


@pytest.mark.parametrize(("former", "present"), [("svr", "pressure"), ("svr-mask", "svr"), ("svr-worth", "saliency"), ("gns", "gns"), (None, "pressure")])
def test_a_job_of_the_first_schema_keeps_its_method_and_says_once_what_it_is_called_now(tmp_path, former, present):
    options = {"colmap": "x"} if former is None else {"colmap": "x", "method": former}
    (tmp_path / "job.json").write_text(json.dumps(GOOD | {"options": options}))
    said = JobFolder(tmp_path).update_schema()
    assert said == ("" if former == present else f"Method '{former or 'svr'}' is called '{present}' now")
    assert JobFolder(tmp_path).options().method == present
    assert JobFolder(tmp_path).update_schema() == "" and JobFolder(tmp_path).options().method == present


@pytest.mark.parametrize(
    ("bad", "said"), [({"iterations": -1}, "whole number of 0 or more"), ({"target": 1.5}, "share above 0"), ({"lambda_f": -1e-4}, "weight of 0")]
)
def test_options_out_of_range_are_refused_when_the_job_is_made(tiny, tmp_path, bad, said):
    with pytest.raises(SceneError, match=said):
        create(tmp_path / "job", tiny, **bad)
    assert not (tmp_path / "job").exists()


def test_a_zero_is_not_left_to_the_default(tmp_path):
    asked = {"colmap": "x", "iterations": 0, "recovery": 0, "holdout": 0, "min_contribution": 0.0, "visible_mask": False, "images": ""}
    (tmp_path / "job.json").write_text(json.dumps(GOOD | {"options": asked}))
    options = JobFolder(tmp_path).options()
    assert RECOVERY and options.iterations == options.recovery == options.holdout == options.min_contribution == 0
    assert options.visible_mask is False and options.images == ""


def test_hostile_arrays_are_refused(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny)
    for kept in (b"", b"\x93NUMPY", None):
        if kept is None:
            np.save(folder / "kept.npy", np.array([object()], dtype=object), allow_pickle=True)
        else:
            (folder / "kept.npy").write_bytes(kept)
        with pytest.raises(FormatError, match="kept.npy"):
            folder.arrays()
    np.save(folder / "kept.npy", np.ones(3, bool))
    with pytest.raises(FormatError, match="expected bool"):
        folder.arrays()


def test_hostile_states_and_metrics_show_nothing_that_is_not_a_fact(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny)
    folder.write_json("state.json", {"state": "running", "count": "many", "psnr": "x", "total": True, "iteration": 3, "evil": 1, "text": ["a"]})
    assert folder.state() == {"state": "running", "iteration": 3}
    (folder / "metrics.csv").write_bytes(b"iteration,count,loss,psnr\n1,2,3,\nnan,1,1,1\n1,2\nx,y,z,w\n1e300,inf,-1,5\n2,9,3,")
    metrics = folder.metrics()
    assert metrics["iteration"].tolist() == [1, 1e300, 2]
    assert job_plot.draw(metrics, 10).shape == (job_plot.SIDE, job_plot.SIDE, 4)
    (folder / "metrics.csv").write_bytes(b"\xff\x00" * 100)
    assert not len(folder.metrics()["iteration"])


def test_the_plot_grows_with_the_run():
    columns = {"iteration": np.arange(1, 51.0), "count": np.linspace(100, 20, 50), "psnr": np.where(np.arange(50) % 5, np.nan, 30.0)}
    half, whole = (job_plot.draw(columns, total) for total in (100, 50))
    for picture, share in ((half, 0.5), (whole, 1.0)):
        colored = (np.ptp(picture[..., :3], axis=-1) > 0.1).any(axis=0)
        assert np.flatnonzero(colored).max() == pytest.approx(share * job_plot.SIDE, abs=2)


def test_discarding_removes_the_job_and_nothing_else(done, tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **SHORT)
    (folder / "mine.txt").write_text("keep")
    folder.discard()
    assert [path.name for path in folder.path.iterdir()] == ["mine.txt"]
    with pytest.raises(FormatError, match="no job"):
        folder.discard()
    with pytest.raises(FormatError, match="no job"):
        JobFolder(tiny.folder).discard()
    assert tiny.splat.exists()


def test_a_folder_in_use_is_refused(tiny, tmp_path):
    (tmp_path / "mine.txt").write_text("keep")
    with pytest.raises(SceneError, match="not empty"):
        create(tmp_path, tiny)
