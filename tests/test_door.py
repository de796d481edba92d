"""The door: every way to prune or to train has every check that makes sense for it."""

from __future__ import annotations

import os
import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from svrgs_addon.files.atomic import reserved
from svrgs_addon.files.images import read_image, to_float, write_image
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.files.splat_format import SplatFormat
from svrgs_addon.prune import pipeline
from svrgs_addon.prune.door import excess_notes
from svrgs_addon.system.errors import MemoryShort, SceneError
from svrgs_addon.views.cameras_json import write_cameras_json
from system_checks import with_pipes

STEPS = "--iterations 20 --recovery 20"
WAYS = {
    "quick": "prune {scene} --data {data} --quick --target 0.5 --out {out}",
    "fine-tuned": f"prune {{scene}} --data {{data}} --target 0.5 {STEPS} --out {{out}}",
    "own pictures": (
        f"prune {{scene}} --seen-from {{cameras}} --seen-from-only --target 0.5 {STEPS} --out {{out}}"
    ),
    "trained": "train --data {data} --iterations 20 --out {out}",
    "merged by blocks": "large prune {scene} --data {data} --target 0.5 --out {out}",
    "merged from cameras": "large prune {scene} --cameras {cameras} --target 0.5 --out {out}",
    "learned by blocks": f"large prune {{scene}} --data {{data}} --method removal {STEPS} --out {{out}}",
    "divided": "large divide {scene} --data {data} --work {out}.work",
    "goes over to merging": "prune {scene} --data {data} --quick --target 0.5 --out {out}",
    "goes over to learning": f"prune {{scene}} --data {{data}} --target 0.5 {STEPS} --out {{out}}",
    "batch": "prune {scene} --batch --data {data} --quick --target 0.5 --out {folder}",
    "farm": f"farm export {{scene}} --data {{data}} --targets 0.5 {STEPS} --out {{job}}",
}


@dataclass(frozen=True)
class Inputs:
    """A private copy of the tiny dataset, and where a way writes."""

    work: Path
    scene: Path
    data: Path
    cameras: Path
    out: Path
    folder: Path  # of the output
    job: Path  # of a farm


@pytest.fixture
def inputs(tiny, tmp_path) -> Inputs:
    shutil.copytree(tiny.folder, tmp_path / "data")
    (tmp_path / "splats").mkdir()
    scene = shutil.copy(tiny.splat, tmp_path / "splats/scene.ply")
    write_cameras_json(tmp_path / "cameras.json", tiny.cameras)
    places = (tmp_path / name for name in ("data", "cameras.json", "results/scene.ply", "results", "job"))
    return Inputs(tmp_path, scene, *places)


def out_of(way: str, inputs: Inputs) -> Path:
    if way == "farm":
        return inputs.job / "results/scene-50.spz"
    return inputs.folder / "scene.spz" if way == "batch" else inputs.out


def prepare(svrgs, way: str, inputs: Inputs):
    """Makes the job of a farm, whose folder must be empty at first."""
    if way == "farm":
        assert svrgs(*WAYS[way].format(**vars(inputs)).split()).status == 0


def refusal(svrgs, way: str, inputs: Inputs, more: str = "") -> str:
    """What a way says that ends with an error, and leaves no output."""
    out = out_of(way, inputs)
    before = out.read_bytes() if out.is_file() else None
    done = svrgs(*f"{WAYS[way]} {more}".format(**vars(inputs)).split())
    if way == "farm" and not done.status:
        done = svrgs("farm", "run", inputs.job)
    assert done.status and "Traceback" not in done.err, done
    assert (out.read_bytes() if out.is_file() else None) == before
    assert not list(inputs.work.glob("**/*.blocks")) and not list(inputs.work.glob("**/*.work"))
    return done.out + done.err


@pytest.fixture(params=WAYS)
def way(request, monkeypatch) -> str:
    def short(*_):
        raise MemoryShort("the scene: needs more memory than there is")

    if request.param.startswith("goes over"):
        monkeypatch.setattr(pipeline.Quick, "open", short)
        monkeypatch.setattr(pipeline.FineTuned, "open", short)
    return request.param


def leave_out(way: str, *ways: str):
    if way in ways:
        pytest.skip("does not arise there")


def test_all_views_are_held_out(svrgs, way, inputs):
    leave_out(way, "own pictures", "merged from cameras")  # some views are always trained on
    assert "all views of the dataset are held out" in refusal(svrgs, way, inputs, "--holdout 1")


def test_the_cameras_do_not_see_the_scene(svrgs, way, inputs):
    if way == "trained":
        views = tiny_dataset.views()
        tiny_dataset.write_colmap(inputs.data / "sparse/0", views, np.full((9, 3), 1e4))
        assert "no training view sees any of the 9 sparse points" in refusal(svrgs, way, inputs)
        return
    scene = read_ply(inputs.scene)
    write_ply(inputs.scene, replace(scene, means=scene.means + np.float32(1e4)))
    assert "none of its Gaussians is near a camera" in refusal(svrgs, way, inputs)


ON_PHOTOGRAPHS = ("fine-tuned", "learned by blocks", "goes over to learning", "farm")
FORCED = "--force"


def result_of(svrgs, way: str, inputs: Inputs) -> str:
    """What a way says that is forced, and ends well."""
    done = svrgs(*f"{WAYS[way]} {FORCED}".format(**vars(inputs)).split())
    if way == "farm":
        done = svrgs("farm", "run", inputs.job)
        done = replace(done, out=done.out + next(inputs.job.glob("results/*.json")).read_text())
    assert done.status == 0, done.err
    return done.out + done.err


def move_most_away(splat: Path):
    """Of five Gaussians four, far below all cameras."""
    scene = read_ply(splat)
    down = np.where(np.arange(scene.count) % 5 > 0, np.float32(400), np.float32(0))
    write_ply(splat, replace(scene, means=scene.means + down[:, None] * np.float32([0, 1, 0])))


def invert(photographs: Path):
    for path in photographs.iterdir():
        write_image(path, 1 - to_float(read_image(path)))


def test_the_views_see_few_of_the_gaussians(svrgs, way, inputs):
    """Of a splat most of which lies elsewhere."""
    leave_out(way, "trained", *ON_PHOTOGRAPHS)
    move_most_away(inputs.scene)
    said = refusal(svrgs, way, inputs)
    assert "views see only 20% of its Gaussians" in said and "(--force)" in said
    said = result_of(svrgs, way, inputs)
    assert way == "divided" or ("see only 20% of its Gaussians; it was forced" in said)


def test_the_photographs_are_of_another_capture(svrgs, way, inputs):
    leave_out(way, "trained", *(name for name in WAYS if name not in ON_PHOTOGRAPHS))
    invert(inputs.data / "images")
    said = refusal(svrgs, way, inputs)
    assert "explains only 0% of the photographs" in said and "(--force)" in said
    if way == "farm":
        shutil.rmtree(inputs.job)
    assert "it was forced" in result_of(svrgs, way, inputs)


def test_a_step_of_a_farm_refuses_photographs_of_another_capture_too(svrgs, inputs):
    invert(inputs.data / "images")
    words = f"large divide {{scene}} --data {{data}} --method removal {STEPS} --work {{work}}/blocks"
    done = svrgs(*words.format(**vars(inputs)).split())
    assert done.status == 2 and "explains only 0% of the photographs" in done.err
    assert not (inputs.work / "blocks").exists()


def test_select_ranks_no_gaussians_that_no_view_sees(svrgs, inputs):
    move_most_away(inputs.scene)
    words = ["select", inputs.scene, "--cameras", inputs.cameras, "--lowest-contribution", 0.5]
    done = svrgs(*words)
    assert done.status == 2 and "12 views see only 20% of its Gaussians" in done.err
    assert svrgs(*words, FORCED, "--json").json["seen"] == pytest.approx(0.2, abs=0.01)
    assert svrgs("select", inputs.scene, "--cameras", inputs.cameras, "--seen-by", "all").status == 0


def test_nothing_of_the_scene_is_visible(svrgs, way, inputs):
    leave_out(way, "trained")
    scene = read_ply(inputs.scene)
    write_ply(inputs.scene, replace(scene, opacity_logits=np.full(scene.count, -20, np.float32)))
    assert "all of its Gaussians have an opacity below 1/255" in refusal(svrgs, way, inputs)


def test_the_output_cannot_be_written(svrgs, way, inputs):
    leave_out(way, "divided")
    prepare(svrgs, way, inputs)
    out_of(way, inputs).parent.write_text("no folder")
    assert "is not a folder" in refusal(svrgs, way, inputs)


def test_the_output_is_that_of_another_job(svrgs, way, inputs):
    leave_out(way, "divided")
    prepare(svrgs, way, inputs)
    with reserved(out_of(way, inputs)):
        assert "another job is writing this file" in refusal(svrgs, way, inputs)


def test_the_output_is_the_input(svrgs, way, inputs):
    leave_out(way, "trained", "divided", "farm")
    scene = inputs.folder / "scene.spz"  # as an output of a batch is named
    write_scene(scene, read_scene(inputs.scene))
    same = replace(inputs, scene=scene, out=scene)
    assert "is the input itself" in refusal(svrgs, way, same, "--overwrite" if way == "batch" else "")


def test_a_package_of_the_format_is_missing(svrgs, way, inputs, monkeypatch):
    leave_out(way, "divided", "batch")  # whose children have their own modules

    def missing(self, path: Path):
        raise SceneError(f"{path}: cannot be written, a package is missing")

    monkeypatch.setattr(SplatFormat, "check_packages", missing)
    assert "a package is missing" in refusal(svrgs, way, inputs)


@with_pipes
def test_the_scene_is_no_regular_file(svrgs, way, inputs):
    leave_out(way, "trained")
    inputs.scene.unlink()
    os.mkfifo(inputs.scene)
    assert "is a pipe or a device" in refusal(svrgs, way, inputs)


@pytest.mark.parametrize(
    ("way", "more", "words"),
    [
        ("quick", "--lambda-f 1", "--quick takes no --lambda-f"),
        ("quick", "--seen-from {cameras}", "leave them out, or --data"),
        ("fine-tuned", "--seen-from {cameras}", "leave them out, or --data"),
        ("own pictures", "--images images", "give --data, or leave it out"),
        ("trained", "--cap 5", "leave --cap out"),
        ("merged by blocks", "--lambda-f 1", "--lambda-f is for methods that decide on photographs"),
        ("merged by blocks", "--background 1,1,1", "--background is for methods"),
        ("merged from cameras", "--images images", "give --data, or leave it out"),
        ("learned by blocks", "--levels 0.5", "--levels are for removals and merges"),
        ("divided", "--lambda-f 1", "--lambda-f is for methods that decide on photographs"),
        ("goes over to merging", "--seen-from {cameras}", "leave them out, or --data"),
        ("goes over to learning", "--seen-from {cameras}", "leave them out, or --data"),
        ("batch", "--lambda-f 1", "--quick takes no --lambda-f"),
        ("farm", "--seen-from {cameras}", "leave them out, or --data"),
    ],
    indirect=["way"],
)
def test_an_option_belongs_to_another_way(svrgs, way, inputs, more, words):
    assert words in refusal(svrgs, way, inputs, more)


def test_convert_and_select_do_not_write_where_a_job_will(svrgs, inputs, tiny):
    levels = inputs.work / "levels/lod-meta.json"
    with reserved(inputs.out), reserved(levels):
        for words in (
            ["convert", inputs.scene, inputs.out],
            ["convert", inputs.scene, tiny.splat, levels],
            ["select", inputs.scene, "--opacity", "0.1,1", "--out", inputs.out],
        ):
            done = svrgs(*words)
            assert done.status == 2 and "another job is writing this file" in done.err, words
    write_scene(inputs.out, read_ply(inputs.scene))
    assert svrgs("convert", inputs.scene, inputs.out).status == 0


def test_only_more_than_there_are_is_an_excess():
    assert excess_notes(5, 5) == [] and excess_notes(6, 5) == [
        "6 Gaussians are asked for, and the scene has 5"
    ]
