"""`svrgs farm run` again: what changed is done anew, and what fails does not end the rest."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace

import pytest

from svrgs_addon.cli.main import main
from svrgs_addon.jobs.farm import run_tasks
from svrgs_addon.jobs.farm.farm_job import FarmJob
from svrgs_addon.views.cameras_json import write_cameras_json


@pytest.fixture
def captures(tiny, tmp_path):
    """A folder with two splats and no photographs."""
    (tmp_path / "captures").mkdir()
    for name in ("a", "b"):
        shutil.copy(tiny.splat, tmp_path / f"captures/{name}.ply")
    return tmp_path / "captures"


def export(captures, *words) -> str:
    job = captures.parent / "job"
    splats = sorted(map(str, captures.glob("*.ply")))
    assert main(["farm", "export", *splats, "--out", str(job), "--target", "0.5", *map(str, words)]) == 0
    return str(job)


def run(capsys, job: str) -> dict[str, bool]:
    """Whether each task was done before."""
    capsys.readouterr()
    assert main(["farm", "run", job, "--json"]) == 0
    return {one["name"]: one["done_before"] for one in json.loads(capsys.readouterr().out)["tasks"]}


def test_a_task_that_fails_does_not_end_the_others(captures, capsys, small_pictures):
    job = export(captures, "--quick")
    (captures / "a.ply").write_bytes((captures / "a.ply").read_bytes()[:5000])
    assert main(["farm", "run", job]) == 2
    assert "a.ply" in capsys.readouterr().err
    farm = FarmJob.read(job)
    assert [bool(farm.result(task)) for task in farm.tasks] == [False, True]


def test_other_cameras_make_a_task_begin_again(tiny, captures, capsys, small_pictures):
    write_cameras_json(captures.parent / "cameras.json", tiny.cameras)
    steps = ["--iterations", 4, "--recovery", 4, "--seen-from-only"]
    job = export(captures, *steps, "--seen-from", captures.parent / "cameras.json")
    assert set(run(capsys, job).values()) == {False} and set(run(capsys, job).values()) == {True}
    write_cameras_json(captures.parent / "cameras.json", tiny.cameras[:9])
    assert set(run(capsys, job).values()) == {False}


def test_a_damaged_result_is_said(captures, capsys, small_pictures):
    job = export(captures, "--quick")
    run(capsys, job)
    farm = FarmJob.read(job)
    path = farm.result_path(farm.tasks[0])
    found = json.loads(path.read_text())
    del found["result"]["method"]
    path.write_text(json.dumps(found))
    assert main(["farm", "report", job]) == 2
    assert "is damaged; delete it, and do the task again" in capsys.readouterr().err


def test_a_task_that_was_stopped_begins_again_with_other_settings(tiny, captures, capsys, monkeypatch):
    words = ["--data", tiny.folder, "--method", "removal", "--iterations", 20, "--recovery", 40]
    job = export(captures, *words)
    farm = FarmJob.read(job)
    prune = run_tasks.prune_scene

    def stopped(options, adapt):
        """After a checkpoint."""
        steps = iter(range(10**6))
        return prune(options, lambda context: replace(adapt(context), stop=lambda: next(steps) > 10))

    with monkeypatch.context() as patch:
        patch.setattr(run_tasks, "prune_scene", stopped)
        assert main(["farm", "run", job]) == 130
    assert list((farm.folder / "results").glob("*.job"))
    export(captures, *words, "--seed", 3)
    assert set(run(capsys, job).values()) == {False}
