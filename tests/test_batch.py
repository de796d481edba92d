"""Folders of scenes: one line of JSON each, failures reported and passed over; from a shell and inside
Blender."""

from __future__ import annotations

import importlib.util
import json
import os
import shlex
import shutil
import signal
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from svrgs_addon.cli.batch_list import Item, expand
from svrgs_addon.files.ply import read_ply
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.jobs import worker
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.system.errors import SceneError

ROOT = Path(__file__).resolve().parents[1]
BATCH = ROOT / "svrgs_addon" / "batch.py"
SVRGS = [sys.executable, "-m", "svrgs_addon"]
SHORT = ("--iterations", "10", "--recovery", "5", "--target", "0.5", "--quiet")


def add_scene(tiny, folder: Path) -> Path:
    """A scene folder that shares the tiny dataset's photographs and model."""
    folder.mkdir(parents=True)
    for part in ("images", "sparse"):
        os.symlink(tiny.folder / part, folder / part)
    return Path(shutil.copy(tiny.splat, folder / "scene.ply"))


@pytest.fixture
def scenes(tiny, tmp_path) -> Path:
    """Three scene folders; the splat of the second is truncated."""
    for name in ("a", "b", "c"):
        splat = add_scene(tiny, tmp_path / "scenes" / name)
    splat = tmp_path / "scenes/b/scene.ply"
    splat.write_bytes(splat.read_bytes()[:1000])
    return tmp_path / "scenes"


def run(*command: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [str(word) for word in command], cwd="/", capture_output=True, text=True, timeout=120
    )


def lines(done: subprocess.CompletedProcess) -> list[dict]:
    """stdout's JSON lines; Blender itself may say more there."""
    return [json.loads(line) for line in done.stdout.splitlines() if line.startswith("{")]


def check_batch(python: list, scenes: Path):
    """One scene pruned, one reported, one pruned; a second time only the failed one is tried."""
    command = [*python, "prune", scenes, *SHORT, "--out", scenes / "out"]
    done = run(*command)
    a, b, c = lines(done)
    assert done.returncode != 0, "one scene failed"
    assert [Path(line["scene"]).parent.name for line in (a, b, c)] == ["a", "b", "c"]
    assert "is incomplete: " in b["error"] and "count" not in b and "Traceback" not in done.stderr, (
        done.stderr
    )
    for line in (a, c):
        assert line["count"] == line["after"]["count"] == 125 == read_scene(line["out"]).count
        assert "error" not in line
    assert sorted(path.name for path in (scenes / "out").iterdir()) == ["a.spz", "c.spz"]
    again = run(*command)
    skipped = [line.get("skipped") for line in lines(again)]
    assert again.returncode != 0 and skipped == ["the output exists", None, "the output exists"]
    assert "error" in lines(again)[1]


# --- from a shell


@pytest.mark.slow
def test_batch_of_a_folder(scenes):
    check_batch([sys.executable, BATCH, "--"], scenes)


@pytest.mark.slow
def test_prune_of_a_folder(scenes):
    installed = ROOT / ".venv/bin/svrgs"
    check_batch([installed] if installed.exists() else SVRGS, scenes)


@pytest.mark.slow
def test_a_batch_without_failures_exits_0_and_overwrites_when_told(tiny, tmp_path):
    scene = add_scene(tiny, tmp_path / "one")
    command = (sys.executable, BATCH, "--", "prune", scene.parent, *SHORT)
    first, second, third = run(*command), run(*command), run(*command, "--overwrite")
    for done in (first, second, third):
        assert done.returncode == 0 and done.stderr == "" and done.stdout.count("\n") == 1
    assert lines(first)[0]["out"] == str(scene.parent / "scene_pruned.spz")
    assert lines(second)[0].keys() == {"scene", "out", "skipped"}
    assert lines(third)[0]["count"] == lines(first)[0]["count"]


@pytest.mark.slow
def test_a_batch_into_the_folder_of_its_scenes_keeps_them_and_says_so(tiny, tmp_path):
    scenes = [tmp_path / f"{name}.spz" for name in ("a", "b")]
    for scene in scenes:
        write_scene(scene, read_ply(tiny.splat))
    before = [scene.read_bytes() for scene in scenes]
    done = run(*SVRGS, "prune", *scenes, "--out", tmp_path, "--data", tiny.folder, *SHORT)
    assert done.returncode == 1 and len(lines(done)) == 2
    assert all("is the input itself" in line["error"] for line in lines(done))
    assert [scene.read_bytes() for scene in scenes] == before


def test_a_scene_that_does_not_exist_is_named(tmp_path):
    done = run(*SVRGS, "prune", tmp_path / "missing.ply")
    assert done.returncode == 2 and "missing.ply: there is no such file" in done.stderr


@pytest.mark.slow
def test_reports_lie_in_a_folder_a_scene(tiny, tmp_path):
    for name in ("a", "b"):
        add_scene(tiny, tmp_path / name)
    done = run(*SVRGS, "prune", tmp_path / "a", tmp_path / "b", *SHORT, "--report", tmp_path / "reports")
    assert done.returncode == 0, done.stderr
    assert sorted(tmp_path.glob("reports/**/*.html")) == [
        tmp_path / "reports" / name / "index.html" for name in ("a", "b")
    ]


def test_batch_runs_other_commands_as_they_are(tiny):
    done = run(sys.executable, BATCH, "--", "info", tiny.splat, "--json")
    assert done.returncode == 0 and json.loads(done.stdout)["count"] == read_ply(tiny.splat).count
    assert run(sys.executable, BATCH, "--", "info", "/nowhere.ply").returncode == 2


def test_usage_errors_are_of_the_batch_not_of_each_scene(scenes):
    done = run(sys.executable, BATCH, "--", "prune", scenes, "--method", "dropout")
    assert (done.returncode, done.stdout) == (2, "") and "method 'dropout' is unknown" in done.stderr


def test_a_job_that_dies_is_reported(tmp_path, monkeypatch):
    deadly = tmp_path / "python"
    deadly.write_text("#!/bin/sh\nkill -9 $$\n")
    deadly.chmod(0o755)
    monkeypatch.setattr(worker.sys, "executable", str(deadly))
    status, result = worker.run_in_child(PruneOptions(scene=Path("a.ply")))
    assert status == -signal.SIGKILL
    assert result == {"error": "the job ended without a result (exit status -9)"}


@pytest.mark.parametrize("number", [signal.SIGINT, pytest.param(signal.SIGTERM, marks=pytest.mark.slow)])
@pytest.mark.parametrize("entry", [(BATCH, "--"), ("-m", "svrgs_addon")], ids=["batch.py", "svrgs"])
@pytest.mark.parametrize("everyone", [True, False], ids=["group", "process"])
def test_a_stopped_batch_can_be_resumed(tiny, tmp_path, number, entry, everyone):
    """A terminal sends Ctrl-C to the whole group of processes, a farm a signal to the one it started."""
    for name in ("a", "b"):
        add_scene(tiny, tmp_path / name)
    words = f"prune {tmp_path}/a {tmp_path}/b --iterations 3000 --recovery 0 --batch".split()
    pipes = {"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, "text": True}
    process = subprocess.Popen([sys.executable, *entry, *words], cwd=ROOT, start_new_session=True, **pipes)
    assert "prune 1/" in process.stderr.readline()
    os.killpg(process.pid, number) if everyone else process.send_signal(number)
    output, errors = process.communicate(timeout=60)
    assert process.returncode == 130 and "Traceback" not in errors and "***" not in errors, errors
    (line,) = output.splitlines()
    assert json.loads(line)["scene"] == str(tmp_path / "a/scene.ply")
    assert "stopped" in json.loads(line)["error"]
    assert sorted(path.name for path in tmp_path.glob("*/*pruned*")) == ["scene_pruned.spz.job"]
    assert len(list(tmp_path.glob("a/*.job/*/manifest.json"))) == 1, "the next scene must not have begun"


# --- inside Blender


@pytest.mark.slow
def test_batch_in_the_process_of_the_bpy_module(scenes):
    if importlib.util.find_spec("bpy") is None:
        pytest.skip("bpy is not installed")
    if (probe := run(sys.executable, "-c", "import bpy")).returncode:
        pytest.skip(f"bpy cannot be imported: {probe.stderr.strip().splitlines()[-1:]}")
    code = (
        f"import bpy, runpy, sys; sys.argv = ['blender', '--', *sys.argv[1:]]; runpy.run_path({str(BATCH)!r},"
        " run_name='__main__')"
    )
    check_batch([sys.executable, "-c", code], scenes)


def test_batch_in_blender(scenes):
    blender = shlex.split(os.environ.get("SVRGS_BLENDER", "")) or list(
        filter(None, [shutil.which("blender")])
    )
    if not blender:
        pytest.skip("SVRGS_BLENDER names no Blender, and none is on PATH")
    check_batch(
        [*blender, "-b", "--factory-startup", "--python-exit-code", 1, "--python", BATCH, "--"], scenes
    )


# --- which scenes


def touch(*paths: Path):
    for path in paths:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.touch()


def test_a_file_is_a_scene_by_itself(tmp_path):
    touch(tmp_path / "x.ply")
    assert expand([tmp_path / "x.ply"], None, None) == [
        Item("x", tmp_path / "x.ply", None, tmp_path / "x_pruned.spz")
    ]
    assert expand([tmp_path / "x.ply"], Path("data"), tmp_path / "y.ply")[0].out == tmp_path / "y.ply"
    assert expand([tmp_path / "x.ply"], None, tmp_path / "new")[0].out == tmp_path / "new/x.spz"
    assert expand([tmp_path / "x.ply"], Path("data"), tmp_path)[0] == Item(
        "x", tmp_path / "x.ply", Path("data"), tmp_path / "x.spz"
    )


def test_folders_of_scenes_and_their_datasets(tmp_path):
    touch(
        tmp_path / "a/scene.ply",
        tmp_path / "a/scene_pruned.spz",
        tmp_path / "a/.svrgs-1.ply",
        tmp_path / "a/sparse/0/x",
    )
    touch(tmp_path / "b/out.ply", tmp_path / "b/cameras.bin", tmp_path / "notes/readme.txt")
    a, b = expand([tmp_path], None, tmp_path / "out")
    assert a == Item("a", tmp_path / "a/scene.ply", tmp_path / "a", tmp_path / "out/a.spz")
    assert b == Item("b", tmp_path / "b/out.ply", tmp_path / "b", tmp_path / "out/b.spz")


def test_the_last_iteration_of_a_3dgs_run(tmp_path):
    names = [f"run/point_cloud/iteration_{number}/point_cloud.ply" for number in ("7000", "30000", "best")]
    touch(tmp_path / "run/input.ply", *(tmp_path / name for name in names))
    (item,) = expand([tmp_path / "run"], None, tmp_path / "out")
    assert (item.name, item.scene, item.out) == ("run", tmp_path / names[1], tmp_path / "out/run.spz")


def test_an_output_file_is_for_one_scene(tmp_path):
    touch(tmp_path / "a/scene.ply", tmp_path / "b/scene.ply")
    assert expand([tmp_path / "a"], None, tmp_path / "small.ply")[0].out == tmp_path / "small.ply"
    with pytest.raises(SceneError, match="small.ply: is the name of a file, but there are 2 scenes"):
        expand([tmp_path / "a", tmp_path / "b"], None, tmp_path / "small.ply")


def test_no_scene_of_a_batch_is_the_output_of_another(tmp_path):
    """As "*.ply" gives it the second time: with --overwrite the second scene would be lost before it is
    read."""
    touch(
        tmp_path / "a.ply",
        tmp_path / "a_pruned.spz",
        tmp_path / "run/point_cloud/iteration_7/point_cloud.spz",
        tmp_path / "x/point_cloud.spz",
    )
    with pytest.raises(SceneError, match=r"a_pruned.spz: is both a scene to prune and an output of .*a.ply"):
        expand([tmp_path / "a.ply", tmp_path / "a_pruned.spz"], None, None)
    with pytest.raises(
        SceneError,
        match=r"iteration_7/point_cloud.spz: is both a scene to prune and an output of .*x/point_cloud.spz",
    ):
        expand(
            [tmp_path / "run", tmp_path / "x/point_cloud.spz"], None, tmp_path / "run/point_cloud/iteration_7"
        )
    (tmp_path / "link.ply").symlink_to(tmp_path / "a_pruned.spz")
    with pytest.raises(SceneError, match="is both a scene to prune"):
        expand([tmp_path / "a.ply", tmp_path / "link.ply"], None, None)


def test_a_default_output_that_is_a_link_is_refused(tmp_path):
    touch(tmp_path / "data/scene.ply")
    (tmp_path / "data/scene_pruned.spz").symlink_to(tmp_path / "elsewhere.ply")
    with pytest.raises(
        SceneError, match="scene_pruned.spz: is a link to .*elsewhere.ply; name the output with --out"
    ):
        expand([tmp_path / "data/scene.ply"], None, None)
    assert (
        expand([tmp_path / "data/scene.ply"], None, tmp_path / "data/scene_pruned.spz")[0].out
        == tmp_path / "data/scene_pruned.spz"
    )


def test_several_splats_in_a_folder_fail_alone(tmp_path):
    touch(tmp_path / "a/x.ply", tmp_path / "a/y.ply", tmp_path / "b/scene.ply")
    several, one = expand([tmp_path], None, None)
    assert one.scene == tmp_path / "b/scene.ply"
    with pytest.raises(SceneError, match=r"a: is a folder, or holds several splats: name the file to use"):
        read_scene(several.scene)


@pytest.mark.parametrize("where", [{"out": Path("out")}, {"out": None, "report": Path("report")}])
def test_scenes_of_one_name_must_not_overwrite_each_other(tmp_path, where):
    touch(tmp_path / "a/x.ply", tmp_path / "b/x.ply")
    both = [tmp_path / "a/x.ply", tmp_path / "b/x.ply"]
    with pytest.raises(SceneError, match="two scenes have the name 'x'"):
        expand(both, None, **where)
    assert [item.out.parent.name for item in expand(both, None, None)] == ["a", "b"]


def test_outputs_are_not_taken_for_scenes(tmp_path):
    touch(tmp_path / "a/scene.ply", tmp_path / "out/a.spz")
    assert [item.name for item in expand([tmp_path], None, tmp_path / "out")] == ["a"]
    with pytest.raises(SceneError, match="choose another folder for the outputs"):
        expand([tmp_path], None, tmp_path)


def test_a_folder_without_scenes(tmp_path):
    touch(tmp_path / "a/scene_pruned.spz", tmp_path / "b/c/deep.ply")
    with pytest.raises(SceneError, match="holds no splat"):
        expand([tmp_path], None, None)
