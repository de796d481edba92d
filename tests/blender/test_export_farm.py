"""Export Farm Job: the selected splats and the settings of the panel, as a job that a farm does with the same
result as Blender."""

from __future__ import annotations

import json
import shutil

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import ended, follow, set_up


@pytest.fixture(autouse=True)
def forgotten():
    """The panel says nothing of these exports to other tests."""
    yield
    part("operators.io.export_farm")._lines.clear()


def export(folder, **words):
    return bpy.ops.svrgs.export_farm_job(directory=str(folder), **words)


def lines() -> str:
    return "\n".join(part("operators.io.export_farm").lines())


def run(folder, *words: str) -> int:
    return part("svrgs_addon.system.subprocess_python").run(["farm", "run", str(folder), *words, "--json"])[0]


def test_a_farm_prunes_as_the_panel_would(splat, bridge, watch, tmp_path):
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40, "seed": 3})
    assert export(tmp_path / "job") == {"FINISHED"} and "Tasks: 1. " in lines()
    written = {path.name for path in (tmp_path / "job").iterdir()}
    assert written >= {"job.json", "template.json", "flamenco.json", "captures"}
    assert run(tmp_path / "job") == 0
    bpy.ops.svrgs.job_start()
    job = part("operators.jobs.job").job_of(splat)
    follow(watch, lambda: ended(job))
    read = part("svrgs_addon.files.registry").read_scene
    (result,) = (tmp_path / "job/results").glob("*.spz")
    one, other = read(result), read(job.folder / "pruned.ply")
    assert one.count == other.count == 100
    assert np.sort(one.means, axis=0) == pytest.approx(np.sort(other.means, axis=0), abs=0.01)


def test_every_selected_splat_is_a_task_with_its_photographs(splat, tmp_path):
    set_up(
        {
            "data": str(DATA / "tiny"),
            "effort": "PHOTOGRAPHS",
            "goal": "SHARE",
            "share": 30,
            "iterations": 40,
            "recovery": 20,
        }
    )
    bpy.ops.object.duplicate()
    splat.select_set(True)
    assert export(tmp_path / "job") == {"FINISHED"}
    contents = json.loads((tmp_path / "job/job.json").read_text())
    assert contents["root"] == str(DATA / "tiny")
    assert [task["options"]["data"] for task in contents["tasks"]] == [".", "."]
    assert run(tmp_path / "job") == 0 and len(list((tmp_path / "job/results").glob("*.spz"))) == 2


def test_a_worker_may_have_job_and_photographs_elsewhere(splat, tmp_path):
    shutil.copytree(DATA / "tiny", tmp_path / "here/tiny")
    set_up(
        {
            "data": str(tmp_path / "here/tiny"),
            "effort": "PHOTOGRAPHS",
            "goal": "SHARE",
            "share": 30,
            "iterations": 40,
            "recovery": 20,
        }
    )
    assert export(tmp_path / "job") == {"FINISHED"}
    assert all(
        str(tmp_path) not in json.dumps(task)
        for task in json.loads((tmp_path / "job/job.json").read_text())["tasks"]
    )
    shutil.move(tmp_path / "here", tmp_path / "there")
    shutil.move(tmp_path / "job", tmp_path / "moved")
    assert run(tmp_path / "moved") != 0
    assert run(tmp_path / "moved", "--root", str(tmp_path / "there/tiny")) == 0
    assert len(list((tmp_path / "moved/results").glob("*.spz"))) == 1


def test_splats_whose_files_would_be_one_are_refused(splat, tmp_path):
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40})
    bpy.ops.object.duplicate()
    splat.select_set(True)
    splat.name, bpy.context.object.name = "a/b", "a_b"
    with pytest.raises(RuntimeError, match="two tasks would have the name 'a_b'"):
        export(tmp_path / "job")
    assert not (tmp_path / "job").exists()


def test_a_time_limit_and_a_folder_with_other_things_are_refused(splat, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40})
    with pytest.raises(RuntimeError, match="no farm job"):
        export(tmp_path)
    set_up({"use_time": True})
    with pytest.raises(RuntimeError, match="one machine"):
        export(tmp_path / "job")
    assert not (tmp_path / "job").exists()
