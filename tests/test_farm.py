"""`svrgs farm`: a job whose tasks any machine does in any order, in Open Job Description and for Flamenco;
killed tasks end with the same bytes."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from command_checks import refused
from svrgs_addon.cli.main import main
from svrgs_addon.files.images import write_image
from svrgs_addon.files.registry import describe, read_scene, write_scene
from svrgs_addon.jobs.farm import engines, run_tasks, summary
from svrgs_addon.jobs.farm.farm_job import FarmJob
from svrgs_addon.jobs.farm.run_tasks import dataset_sha256

ROOT = Path(__file__).resolve().parents[1]
FLAMENCO = ROOT / "svrgs_addon/jobs/farm/flamenco/svrgs_prune.js"
STEPS = ["--iterations", "40", "--recovery", "20"]
TO_THE_END = ("--step", "Finish", "--run-dependencies")  # of a large scene


@pytest.fixture
def captures(tiny, tmp_path):
    """A folder of two captures."""
    for name in ("one", "two"):
        shutil.copytree(tiny.folder, tmp_path / "captures" / name)
    return tmp_path / "captures"


@pytest.fixture
def job(captures, tmp_path, svrgs):
    """A farm job of four tasks."""
    words = "--methods removal,opacity --targets 0.5", *STEPS
    assert svrgs("farm export", captures, "--out", tmp_path / "job", *words).status == 0
    return tmp_path / "job"


def digests(folder: Path) -> dict[str, str]:
    return {path.name: run_tasks.sha256(path) for path in sorted((folder / "results").glob("*.spz"))}


@pytest.fixture
def alone(job):
    """The results of one machine that does all tasks."""
    assert main(["farm", "run", str(job)]) == 0
    found = digests(job)
    assert len(found) == 4
    shutil.rmtree(job / "results")
    return found


def test_a_job_holds_every_setting_with_paths_within_the_captures(job, captures):
    contents = json.loads((job / "job.json").read_text())
    assert contents["root"] == str(captures) and [task["name"] for task in contents["tasks"]] == [
        "one-removal-50", "one-opacity-50", "two-removal-50", "two-opacity-50",
    ]  # fmt: skip
    expected = {"iterations": 40, "recovery": 20, "data": "one", "method": "opacity", "target": 0.5}
    assert contents["tasks"][1] == {"name": "one-opacity-50", "scene": "one/scene.ply", "options": expected}


def test_tasks_in_any_order_and_elsewhere_give_the_same_bytes(job, alone, captures, tmp_path):
    shutil.move(captures, tmp_path / "elsewhere")
    for numbers in ("3", "0-1,2"):
        assert main(["farm", "run", str(job), "--root", str(tmp_path / "elsewhere"), "--tasks", numbers]) == 0
    assert digests(job) == alone


def test_what_is_done_stays_and_what_was_changed_is_done_again(job, captures, tmp_path, svrgs):
    done = lambda: svrgs("farm run", job, "--tasks 0 --json").json["tasks"][0]
    first = done()
    assert done() == first | {"done_before": True} and not first["done_before"]
    scene, _ = captures / "one/scene.ply", shutil.copy(captures / "one/scene.ply", tmp_path / "kept.ply")
    write_scene(scene, read_scene(scene).select(np.arange(200)))
    # another scene under the same name
    assert not done()["done_before"] and describe(first["out"])["count"] == 100
    shutil.copy(tmp_path / "kept.ply", scene)
    photograph = next(one for one in sorted((captures / "one").rglob("*")) if one.suffix in (".png", ".jpg"))
    shutil.copy(photograph, tmp_path / "kept.png")
    write_image(photograph, np.zeros((48, 64, 3), np.uint8))
    assert dataset_sha256(captures / "one", "") not in ("", dataset_sha256(captures / "two", ""))
    assert not done()["done_before"], "another photograph under the same name"
    shutil.copy(tmp_path / "kept.png", photograph)
    assert done() == first
    Path(first["out"]).write_bytes(b"half a file")
    assert done() == first


def test_names_that_a_shell_would_read_become_plain(captures, tmp_path):
    for name in ("Scan (1)", "a$b&c;d"):
        shutil.copytree(captures / "one", captures / name)
    words = ["--out", str(tmp_path / "job"), "--method", "removal", "--target", "0.5", *STEPS]
    assert main(["farm", "export", str(captures), *words]) == 0
    names = {task.name.removesuffix("-removal-50") for task in FarmJob.read(tmp_path / "job").tasks}
    assert names == {"Scan _1_", "a_b_c_d", "one", "two"}


def test_a_photograph_of_the_same_size_with_other_pixels_is_another_dataset(captures):
    before = dataset_sha256(captures / "one", "")
    photograph = next((captures / "one/images").iterdir())
    contents = photograph.read_bytes()
    photograph.write_bytes(bytes([*contents[:-20], contents[-20] ^ 1, *contents[-19:]]))
    assert dataset_sha256(captures / "one", "") != before


def test_the_folder_that_was_given_is_that_of_the_captures_even_of_one(captures, tmp_path):
    shutil.rmtree(captures / "two")
    words = ["--out", str(tmp_path / "job"), "--targets", "0.5", *STEPS]
    assert main(["farm", "export", str(captures), *words]) == 0
    contents = json.loads((tmp_path / "job/job.json").read_text())
    assert contents["root"] == str(captures) and contents["tasks"][0]["scene"] == "one/scene.ply"


@pytest.mark.parametrize("link", ["results", "results/one-removal-50.spz", "report", "report/table.md"])
def test_nothing_is_written_through_links_of_a_job_folder(job, tmp_path, svrgs, link):
    victim = tmp_path / "victim"
    if link in ("results", "report"):
        victim.mkdir()
        (victim / "mine.txt").write_text("mine")
    else:
        victim.write_text("mine")
    if link.startswith("report"):
        assert svrgs("farm run", job, "--tasks 0").status == 0
    (job / link).parent.mkdir(exist_ok=True)
    (job / link).symlink_to(victim)
    action = "report" if link.startswith("report") else "run"
    done = svrgs("farm", action, job)
    assert done.status == 2 and "is a link" in done.err
    assert [file.read_text() for file in ([victim] if victim.is_file() else victim.iterdir())] == ["mine"]


def test_the_report_has_all_tasks_and_means_over_the_scenes(job, svrgs):
    early = svrgs("farm report", job)
    assert early.status == 2 and "none of its 4 tasks is done" in early.err
    assert svrgs("farm run", job, "--tasks 0-2").status == 0
    facts = svrgs("farm report", job, "--json").json
    assert facts["missing"] == ["two-opacity-50"] and len(facts["tasks"]) == 3
    # opacity was not done on all scenes
    assert [row["method"] for row in facts["over_all_scenes"]] == ["removal"]
    page = (job / "report/index.html").read_text()
    assert "two-opacity-50" in page and "<svg" in page and page.count("<tr>") == 4
    rows = {row["name"]: row for row in facts["tasks"]}
    scene, out = rows["one-removal-50"]["files"]
    assert f"svrgs view {scene} {out}" in page and Path(out).is_file() and scene != out
    assert rows["one-removal-50"]["kept"] == 0.5
    assert rows["one-opacity-50"]["loss"] > rows["one-removal-50"]["loss"]


@pytest.mark.slow
def test_results_have_the_format_that_is_asked_for(captures, tmp_path):
    words = ["--out", str(tmp_path / "job"), "--to", "spz", "--quick", "--targets", "0.4", "--no-photographs"]
    assert main(["farm", "export", str(captures / "one/scene.ply"), *words]) == 0
    assert main(["farm", "run", str(tmp_path / "job")]) == 0
    assert describe(tmp_path / "job/results/scene-40.spz")["count"] == 100


# --- Open Job Description


def openjd_run(job: Path, *words: str) -> subprocess.Popen:
    values = {
        one["name"]: one["value"]
        for one in json.loads((job / "parameter_values.json").read_text())["parameterValues"]
    }
    return engine_run(job / "template.json", values, job, *words)


def engine_run(template: Path, values: dict, folder: Path, *words: str) -> subprocess.Popen:
    """Runs a template with these parameters. folder: for a script that is svrgs."""
    pytest.importorskip("openjd")
    svrgs = folder / "svrgs"
    svrgs.write_text(f'#!/bin/sh\nexec {sys.executable} -m svrgs_addon "$@"\n')
    svrgs.chmod(0o755)
    parameters = [f"{name}={value}" for name, value in (values | {"Svrgs": svrgs}).items()]
    command = [
        sys.executable,
        "-m",
        "openjd",
        "run",
        str(template),
        *(word for one in parameters for word in ("-p", one)),
        *words,
    ]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, cwd=ROOT)


@pytest.mark.skipif(sys.platform == "win32", reason="a script of sh")
def test_an_engine_runs_the_whole_job(job, alone):
    run = openjd_run(job, "-p", "TasksPerChunk=3", "--step", "Report", "--run-dependencies")
    said = run.communicate(timeout=300)[0]
    assert run.returncode == 0, said
    assert "openjd_progress: 100.00" in said and "openjd_status: one-removal-50: " in said
    assert "Chunks run: 3" in said
    assert digests(job) == alone and (job / "report/index.html").is_file()


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a script of sh")
def test_a_task_that_is_killed_and_tried_again_ends_with_the_same_bytes(captures, tmp_path):
    words = ["--out", str(tmp_path / "job"), "--targets", "0.5", "--iterations", "6000", "--recovery", "100"]
    assert main(["farm", "export", str(captures / "one"), *words]) == 0
    job = tmp_path / "job"
    assert main(["farm", "run", str(job)]) == 0
    expected = digests(job)
    shutil.rmtree(job / "results")
    for seconds in (1.0, 1.5):
        engine = openjd_run(job, "--step", "Prune")
        found = wait_for_task(job)
        time.sleep(seconds)
        subprocess.run(["kill", "-9", *found], check=False)
        assert engine.wait(timeout=60) != 0
        engine.stdout.close()
        assert not list((job / "results").glob("*.json"))
    engine = openjd_run(job, "--step", "Prune")
    assert "openjd_fail" not in engine.communicate(timeout=120)[0] and engine.returncode == 0
    assert digests(job) == expected


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a script of sh")
def test_an_engine_prunes_a_large_scene_as_one_machine_does(tiny, tmp_path, capsys):
    from svrgs_addon.views.cameras_json import write_cameras_json

    write_cameras_json(tmp_path / "cameras.json", tiny.cameras)
    words = f"--cameras {tmp_path}/cameras.json --block 60 --target 0.4 --out {tmp_path}/one.ply".split()
    assert main(["large", "prune", str(tiny.splat), *words, "--json"]) == 0
    told = json.loads(capsys.readouterr().out)
    assert told["after"]["count"] == describe(tmp_path / "one.ply")["count"] == 100 and told["views"] == 10
    assert told["psnr"] > 15
    assert {path.name for path in tmp_path.iterdir()} == {"cameras.json", "one.ply"}, "the blocks are deleted"
    values = {
        "Scene": tiny.splat,
        "Cameras": tmp_path / "cameras.json",
        "Work": tmp_path / "work",
        "Out": tmp_path / "many.ply",
        "Target": 0.4,
    }
    values |= {"Block": 60, "Parts": 3, "LastPart": 2}
    (tmp_path / "work").mkdir()
    run = engine_run(engines.TEMPLATE.with_name("large_scene.json"), values, tmp_path, *TO_THE_END)
    said = run.communicate(timeout=120)[0]
    assert run.returncode == 0 and "openjd_status: score: " in said, said
    assert (tmp_path / "many.ply").read_bytes() == (tmp_path / "one.ply").read_bytes()
    assert len(json.loads((tmp_path / "work/blocks.json").read_text())["blocks"]) == 8


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="a script of sh")
def test_an_engine_lets_a_method_decide_on_a_large_scene_as_one_machine_does(tiny, tmp_path):
    words = f"--data {tiny.folder} --method svr --block 70 --target 0.4 --out {tmp_path}/one.ply".split()
    assert main(["large", "prune", str(tiny.splat), *words, *STEPS]) == 0
    values = {
        "Scene": tiny.splat,
        "Dataset": tiny.folder,
        "Work": tmp_path / "work",
        "Out": tmp_path / "many.ply",
        "Target": 0.4,
        "Method": "svr",
    }
    values |= {"Iterations": 40, "Recovery": 20, "Block": 70, "Parts": 2, "LastPart": 1}
    (tmp_path / "work").mkdir()
    template = engines.TEMPLATE.with_name("large_scene_photographs.json")
    run = engine_run(template, values, tmp_path, *TO_THE_END)
    said = run.communicate(timeout=180)[0]
    assert run.returncode == 0 and "openjd_status: decide: " in said, said
    assert (tmp_path / "many.ply").read_bytes() == (tmp_path / "one.ply").read_bytes()


def wait_for_task(job: Path) -> list[str]:
    """Process numbers of what does a task of the job."""
    end = time.monotonic() + 60
    while time.monotonic() < end:
        found = subprocess.run(
            ["pgrep", "-f", f"svrgs_addon farm run {job}"], capture_output=True, text=True, check=False
        ).stdout.split()
        if found:
            return found
        time.sleep(0.02)
    raise AssertionError("no task began")


def test_the_template_asks_for_the_memory_of_the_largest_task():
    amounts = {
        one["name"]: one["min"]
        for one in engines.template(3 << 30)["steps"][0]["hostRequirements"]["amounts"]
    }
    assert amounts == {"amount.worker.vcpu": 2, "amount.worker.memory": 3072}


def test_a_failed_task_is_told_to_the_engine(job, captures, svrgs):
    (captures / "two/scene.ply").write_bytes(b"ply\n")
    told = svrgs("farm run", job, "--tasks 2 --messages openjd")
    assert told.status == 2
    assert "openjd_fail: task two-removal-50: " in told.out and "two/scene.ply" in told.err
    assert not list((job / "results").glob("*.spz"))


# --- Flamenco

AUTHOR = """
const tasks = [];
function made(kind, name, type) {
  return {
    name, type, commands: [], after: [],
    addCommand(one) { this.commands.push(one); },
    addDependency(one) { this.after.push(one.name); },
  };
}
const author = {
  Task: (name, type) => made("task", name, type),
  Command: (name, parameters) => ({ name, parameters }),
};
function graph(settings) {
  tasks.length = 0;
  compileJob({ settings, addTask: (one) => tasks.push(one) });
  return JSON.stringify(tasks);
}
"""


@pytest.fixture
def flamenco():
    """Runs compileJob() of the job type, with an author that only notes. Returns a function from settings to
    tasks."""
    context = pytest.importorskip("quickjs").Context()
    context.eval(AUTHOR + FLAMENCO.read_text())
    return lambda settings: json.loads(context.eval(f"graph({json.dumps(settings)})"))


def test_flamenco_does_the_tasks_in_chunks_and_then_the_report(job, flamenco, captures):
    submission = json.loads((job / "flamenco.json").read_text())
    assert submission["type"] == "svrgs-prune" and submission["name"] == "job"
    tasks = flamenco(submission["settings"] | {"tasks_per_chunk": 3})
    assert [(task["name"], task["after"]) for task in tasks] == [
        ("prune 0-2", []),
        ("prune 3", []),
        ("report", ["prune 0-2", "prune 3"]),
    ]
    words = ["farm", "run", str(job), "--root", str(captures), "--tasks", "0-2"]
    assert tasks[0]["commands"] == [{"name": "exec", "parameters": {"exe": "svrgs", "args": words}}]
    assert tasks[0]["type"] == "misc"
    assert tasks[2]["commands"][0]["parameters"]["args"] == ["farm", "report", str(job)]


def test_what_flamenco_asks_for_is_what_a_submission_has(job, flamenco):
    settings = json.loads((job / "flamenco.json").read_text())["settings"]
    context = pytest.importorskip("quickjs").Context()
    keys = json.loads(
        context.eval(FLAMENCO.read_text() + "JSON.stringify(JOB_TYPE.settings.map((one) => one.key))")
    )
    assert sorted(keys) == sorted(settings)


# --- jobs of strangers, and words that do not fit


@pytest.mark.parametrize(
    "change, said",
    [
        ({"schema": 2}, "no farm job of this version"),
        ({"to": ".exe"}, "no farm job of this version"),
        ({"tasks": 3}, "no farm job of this version"),
        ({"tasks": [{"name": "../a", "scene": "a", "options": {}}]}, "no plain name"),
        ({"tasks": [{"name": "a", "options": {}}]}, "without a name or a scene"),
        ({"tasks": [{"name": "a", "scene": "a", "options": {"shell": "rm"}}]}, "'shell' is no option"),
        ({"tasks": [{"name": "a", "scene": "a", "options": {"target": "half"}}]}, "'target' is not"),
        ({"tasks": [{"name": "a", "scene": "a", "options": {"resume": True}}]}, "the option resume"),
        ({"tasks": [{"name": "a", "scene": "a", "options": {"background": [0, 1]}}]}, "'background' is not"),
    ],
)
def test_a_job_that_is_none_is_one_sentence(job, change, said, svrgs):
    contents = json.loads((job / "job.json").read_text())
    (job / "job.json").write_text(json.dumps(contents | change))
    refused(svrgs("farm run", job), said, str(job / "job.json"))


@pytest.mark.parametrize("numbers", ("4", "3-1", "a", "-1", "0,,1"))
def test_numbers_of_tasks_that_there_are_not(job, numbers, svrgs):
    refused(svrgs("farm run", job, f"--tasks={numbers}"), "0 to 3")


def test_a_folder_with_other_things_is_no_place_for_a_job(captures, svrgs):
    refused(svrgs("farm export", captures, "--out", captures / "one"), "no farm job")


@pytest.mark.parametrize(
    "words, said",
    [
        ("--methods removal,none", "'none'"),
        ("--targets 0.5 --target-count 9", "leave one out"),
        ("--quick", "--quick needs --target"),
        ("--quick --target 0.5 --nested 0.5", "--quick takes no --nested"),
        ("--target 0.5 --target-format .sog", "--target-format is about --target-size"),
        ("--target-size 1 --target-format .foo", "scenes are written as"),
    ],
)
def test_options_that_every_task_would_refuse_are_refused(captures, tmp_path, svrgs, words, said):
    refused(svrgs("farm export", captures, "--out", tmp_path / "a", words), said)
    assert not (tmp_path / "a").exists()


def test_every_option_survives_the_way_through_the_file(captures, tmp_path):
    words = (
        "--background 0.5,0.25,1 --lambda-f 1e-3 --visible-mask --seed 7 --max-drop 0.5 --nested 0.2"
    ).split()
    assert main(["farm", "export", str(captures / "one"), "--out", str(tmp_path / "job"), *words]) == 0
    job = FarmJob.read(tmp_path / "job")
    options = job.options(job.tasks[0])
    given = {
        "background": (0.5, 0.25, 1.0),
        "lambda_f": 1e-3,
        "visible_mask": True,
        "seed": 7,
        "max_drop": 0.5,
    }
    given |= {"nested": 0.2, "data": captures / "one", "resume": True, "scene": captures / "one/scene.ply"}
    assert {name: getattr(options, name) for name in given} == given


def test_losses_that_are_assumed_are_not_mixed_with_measured_ones():
    row = {"method": "removal", "target": 0.5, "kept": 0.5, "seconds": 1}
    rows = [
        row | {"scene": "one", "against": "photographs", "loss": 1.0},
        row | {"scene": "two", "against": "photographs", "loss": 2.0},
        row | {"scene": "three", "against": "its own pictures", "loss": 9.0},
    ]
    found = {mean["against"]: (mean["scenes"], mean["loss"]) for mean in summary._means(rows)}
    assert found == {"photographs": (2, 1.5), "its own pictures": (1, 9.0)}
    assert all(f"removal, {against}" in summary._chart(rows, summary._means(rows)) for against in found)
