"""A job in a process of its own: started, followed, stopped, killed, orphaned; its folder, honest and
hostile."""

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
from job_checks import LONG, MEDIUM, ROOT, SHORT, at_work, create, follow
from svrgs_addon.files.ply import read_ply
from svrgs_addon.jobs import job_folder as folders
from svrgs_addon.jobs import job_plot
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.system.errors import FormatError, SceneError


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
    assert metrics["iteration"][-1] == 60 and metrics["count"][-1] == 125
    assert np.isfinite(metrics["psnr"]).any()


def test_files_in_the_current_folder_are_not_taken_for_modules(tiny, tmp_path, monkeypatch):
    for name in ("json.py", "svrgs_addon.py"):
        (tmp_path / name).write_text("raise SystemExit('of another program')")
    monkeypatch.chdir(tmp_path)
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    job.start()
    follow(job)
    assert job.state == "done"


def test_the_score_orders_the_source_as_the_job_did(done, tiny):
    job, _ = done
    kept, score = job.folder.arrays()
    assert kept.sum() == 125 and (score[kept] > 0.5).all() and (score[~kept] < 0.5).all()
    assert (score >= 0).all()
    assert len(np.unique(score)) == tiny_dataset.COUNT, "any count can be asked for"
    faint = np.arange(tiny_dataset.COUNT) >= 2 * tiny_dataset.SEEN
    assert not kept[faint].any(), "what no view can show goes first"
    assert score[faint].max() < score[~faint & ~kept].max()
    pruned, source = read_ply(job.folder / "pruned.ply"), read_ply(tiny.splat)
    # recovered Gaussians stay in the source's order, near where they were
    assert np.abs(pruned.means - source.means[kept]).max() < 0.2


def test_stop_saves_a_checkpoint_and_resume_goes_on_there(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, lambda job: job.facts.get("iteration", 0) > 200 or not job.running)
    job.stop()
    assert job.stopping
    follow(job)
    assert job.state == job.folder.state()["state"] == "stopped" and not job.stopping
    saved = job.folder.checkpoint()
    assert saved > 200
    assert job.resume_point() == ("Resume continues at {share:.0%}", {"share": saved / 20_000})
    job.start()
    assert not (job.folder / "stop").exists()
    heard = follow(job, at_work)
    assert job.state == "running"
    assert min(message["iteration"] for message in heard if message["type"] == "PROGRESS") > saved


def test_stop_while_the_job_is_still_reading(tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, lambda job: job.state == "running")
    job.stop()
    follow(job, seconds=2)
    assert job.state == "stopped" and job.resume_point() == ("Resume starts it from the beginning", {})


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGSTOP"), reason="this system cannot hold a process")
def test_a_job_that_gives_no_sign_of_life_is_killed_and_says_from_where_it_goes_on(
    tiny, tmp_path, jobs, monkeypatch
):
    monkeypatch.setattr("svrgs_addon.jobs.job_process.NO_REACTION", 1.0)
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    os.kill(job._process.pid, signal.SIGSTOP)  # as if its disk did not answer
    time.sleep(2)  # no renewal is under way any more
    job.stop()
    follow(job, seconds=20)
    assert job.state == "stopped" and job.facts["text"] == "It gave no sign of life and was ended"
    assert job.resume_point() == ("Resume starts it from the beginning: no checkpoint was saved", {})


@pytest.mark.slow
def test_a_job_that_is_slow_to_save_is_not_killed(tiny, tmp_path, jobs, monkeypatch):
    """Only one that gives no sign of life is."""
    monkeypatch.setattr("svrgs_addon.jobs.job_process.NO_REACTION", 3.0)
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    monkeypatch.setattr(job.folder, "raise_flag", lambda: None)  # it hears nothing, and goes on
    job.stop()
    until = time.monotonic() + 5
    follow(job, lambda job: time.monotonic() > until)
    assert job.running and job.stopping
    job.kill()
    follow(job)
    assert job.state == "stopped" and job.facts["text"] == ""


def test_an_aborted_job_stays_failed_whatever_its_process_wrote_before(tiny, tmp_path, jobs, monkeypatch):
    monkeypatch.setattr("svrgs_addon.jobs.job_process.REFRESH_EVERY", 0.0)
    job = Job(create(tmp_path / "job", tiny, **LONG))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    job.folder.write_json("state.json", {"state": "running"})
    job.abort("its folder is gone")
    job.refresh()
    assert job.state == "failed" and job.facts["text"] == "its folder is gone"


@pytest.mark.slow
def test_a_job_that_another_process_continued_is_seen(tiny, tmp_path, jobs, monkeypatch):
    monkeypatch.setattr("svrgs_addon.jobs.job_process.REFRESH_EVERY", 0.0)
    job = Job(create(tmp_path / "job", tiny, **SHORT))
    jobs.append(job)
    job.folder.write_json("state.json", {"state": "stopped"})
    seen = Job(JobFolder(job.folder.path))
    job.start()
    seen.refresh()
    assert seen.state in ("starting", "running")
    follow(job)
    seen.refresh()
    assert seen.state == "done"


def result_bytes(job: Job) -> list[bytes]:
    return [
        (job.folder / name).read_bytes() for name in ("pruned.ply", "kept.npy", "score.npy", "metrics.csv")
    ]


@pytest.fixture(scope="module")
def undisturbed(tiny, tmp_path_factory) -> list[bytes]:
    """What a job of medium length leaves when nothing comes between."""
    job = Job(create(tmp_path_factory.mktemp("undisturbed") / "job", tiny, **MEDIUM))
    job.start()
    follow(job)
    assert job.state == "done", (job.facts, job.folder.log_tail())
    return result_bytes(job)


@pytest.mark.slow
@pytest.mark.parametrize("stops", [1, 3])
def test_stopped_jobs_end_as_if_they_had_not_been(undisturbed, tiny, tmp_path, jobs, stops):
    job = Job(create(tmp_path / "job", tiny, **MEDIUM))
    jobs.append(job)
    for k in range(stops):
        job.start()
        follow(job, lambda job, k=k: job.facts.get("iteration", 0) > 150 * (k + 1) or not job.running)
        job.stop()
        follow(job)
        assert job.state == job.folder.state()["state"] == "stopped"
        assert 150 * (k + 1) < job.folder.state()["iteration"] < 1000
    job.start()
    follow(job)
    assert job.state == "done", job.facts
    assert result_bytes(job) == undisturbed


@pytest.mark.slow
def test_a_killed_job_is_interrupted_and_goes_on_to_the_same_bytes(undisturbed, tiny, tmp_path, jobs):
    job = Job(create(tmp_path / "job", tiny, **MEDIUM))
    jobs.append(job)
    job.start()
    follow(job, at_work)
    subprocess.Popen.kill(job._process)  # the process alone, as another program would
    follow(job)
    assert job.state == "interrupted" and "killed" in job.facts["text"]
    again = Job(JobFolder(job.folder.path))  # as after the file was opened again
    assert again.state == "interrupted"
    jobs.append(again)
    again.start()
    follow(again)
    assert result_bytes(again) == undisturbed


@pytest.mark.slow
def test_a_job_whose_parent_dies_saves_a_checkpoint_and_ends(tiny, tmp_path):
    folder = create(tmp_path / "job", tiny, **LONG)
    code = (
        "import sys, time\nfrom svrgs_addon.jobs.job_process import Job\nfrom svrgs_addon.jobs.job_folder"
        " import JobFolder\njob = Job(JobFolder(sys.argv[1]))\njob.start()\nwhile job.facts.get('iteration',"
        " 0) < 20:\n    job.poll()\n    time.sleep(0.02)\nprint('working', flush=True)\ntime.sleep(60)\n"
    )
    with subprocess.Popen(
        [sys.executable, "-c", code, str(folder.path)], cwd=ROOT, stdout=subprocess.PIPE
    ) as parent:
        assert parent.stdout.readline().strip() == b"working"
        child = folder.state()["pid"]
        parent.kill()
    end = time.monotonic() + 10
    while folder.state()["state"] != "interrupted" and time.monotonic() < end:
        time.sleep(0.05)
    # written by the job itself, not inferred
    assert json.loads((folder / "state.json").read_bytes())["state"] == "interrupted"
    assert list((folder / "recovered.ply.job").glob("*/manifest.json"))
    while Path(f"/proc/{child}/stat").exists() and time.monotonic() < end:
        time.sleep(0.05)
    assert (
        not Path(f"/proc/{child}").exists()
        or "Z" in Path(f"/proc/{child}/stat").read_text().split(")")[1][:3]
    )


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
    folder = JobFolder.create(tmp_path / "job", read_ply(tiny.splat), {"data": str(tmp_path / "gone")})
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


def test_the_plot_grows_with_the_run():
    columns = {
        "iteration": np.arange(1, 51.0),
        "count": np.linspace(100, 20, 50),
        "psnr": np.where(np.arange(50) % 5, np.nan, 30.0),
    }
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
