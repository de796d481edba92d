"""Methods with lambda_F on photographs, block by block: one block is as the scene in memory, more of them
differ little, in any order."""

from __future__ import annotations

import json
import logging
import shutil
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import room_dataset
from block_checks import ready
from job_checks import create
from plans import prune_settings
from short_runs import to_the_end
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.plan import Plan
from svrgs_addon.finetune.quality import hold_apart, quality_views
from svrgs_addon.finetune.run import Run
from svrgs_addon.jobs.job_recorder import PruneRecorder
from svrgs_addon.native.library import supported_levels
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import pipeline
from svrgs_addon.prune.blocks.block_rasterizer import BlockRasterizer
from svrgs_addon.prune.blocks.divided import Divided, divide, gathered, scene_of
from svrgs_addon.prune.blocks.learning import decide, recover, targets
from svrgs_addon.prune.blocks.request import FILE, Request, methods
from svrgs_addon.prune.blocks.tuning import CUT, TUNED
from svrgs_addon.prune.likeness import PhotographLikeness
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.render.metrics.evaluate import evaluate
from svrgs_addon.scene.gaussians import PARAMETERS, Scene
from svrgs_addon.system.errors import FormatError, MemoryShort, SceneError
from svrgs_addon.views.dataset import Dataset, load_dataset
from tiny_dataset import COUNT, FAINT

STEPS = ("--iterations", 40, "--recovery", 20)
SHORT = MemoryShort(
    "a.ply: fine-tuning needs 90 GB of memory, but only 1 GB is available; svrgs large prunes it by blocks,"
    " with less"
)


def learned(tiny, data, folder, most: int, plan, order=None, wanted: int = 0) -> tuple[Divided, Divided]:
    """What is decided on, and what is recovered; in this order of the blocks."""
    divided = ready(tiny.splat, data, folder, most)
    shares = [round(wanted * block.count / divided.count) for block in divided.blocks]
    numbers = [block.number for block in divided.blocks]
    for number in order(numbers) if order else numbers:
        decide(divided, number, data, plan, shares[number])
    left = gathered(folder / CUT, divided)
    for number in order(numbers) if order else numbers:
        recover(divided, number, data, plan)
    return left, gathered(folder / TUNED, left)


def together(divided: Divided) -> dict[str, np.ndarray]:
    parts = [scene_of(divided, block) for block in divided.blocks]
    return {name: np.concatenate([getattr(part, name) for part in parts]) for name in PARAMETERS}


@pytest.mark.parametrize("method", ["removal", "saliency", "svr", "svr-b"])
def test_one_block_is_decided_as_the_scene_in_memory(tiny, data, tmp_path, svrgs, method):
    """To the bit: with all photographs and all Gaussians, nothing is left out."""
    words = f"--data {tiny.folder} --method {method} --iterations 40 --recovery 0 --visible-mask"
    job = svrgs("prune", tiny.splat, words, "--lambda-f", 0.02, "--out", tmp_path / "o.ply")
    assert job.status == 0
    asked = PruneOptions(data=tiny.folder, method=method, iterations=40, recovery=0, lambda_f=0.02)
    plan = Request.of(asked).plan()
    left, _ = learned(tiny, data, tmp_path / "blocks", COUNT, plan)
    whole, found = read_scene(tmp_path / "o.ply"), together(left)
    assert 20 < whole.count < COUNT - FAINT and left.count == whole.count
    for name in PARAMETERS:
        assert (found[name] == getattr(whole, name)).all(), name


@pytest.fixture(scope="module")
def inside(tmp_path_factory) -> tuple[SimpleNamespace, Dataset]:
    """A room and its photographs, each of which shows a part of it."""
    folder = tmp_path_factory.mktemp("room")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(room_dataset, "WIDTH", 240)
        patch.setattr(room_dataset, "HEIGHT", 160)
        room_dataset.write_room(folder, 6_000, 16)
    return SimpleNamespace(splat=folder / "scene.ply", folder=folder), load_dataset(folder)


@pytest.mark.slow
def test_blocks_are_decided_and_recovered_in_any_order_and_nearly_as_well(inside, tmp_path):
    room, photographs = inside
    plan = prune_settings("removal", 40, 100, full=False)
    quality = PhotographLikeness(photographs, BlockRasterizer).psnr
    _, best = learned(room, photographs, tmp_path / "one", 6_000, plan, wanted=3_000)
    left, recovered = learned(room, photographs, tmp_path / "many", 2_000, plan, wanted=3_000)
    again = learned(room, photographs, tmp_path / "again", 2_000, plan, reversed, wanted=3_000)
    assert len(left.blocks) == 4 and left.count == recovered.count == best.count == 3_000
    for first, second in zip((left, recovered), again, strict=True):
        assert all((array == together(second)[name]).all() for name, array in together(first).items())
    assert quality(recovered) > max(quality(left) + 0.2, quality(best) - 0.5)
    assert quality(recovered) == pytest.approx(evaluate_of(recovered, photographs), abs=0.01)


def evaluate_of(divided: Divided, data: Dataset) -> float:
    scene = replace(scene_of(divided, divided.blocks[0]), **together(divided))
    return evaluate(scene, data, data.test_indices, Rasterizer())["psnr"]


@pytest.mark.slow
def test_lambda_f_is_the_same_price_in_all_blocks(tiny, data, tmp_path):
    plan = prune_settings("saliency", 30, 0, full=False, lambda_f=2e-2)
    counts = [learned(tiny, data, tmp_path / str(most), most, plan)[0].count for most in (COUNT, COUNT // 4)]
    assert 20 < counts[0] < COUNT - FAINT and counts[1] == pytest.approx(counts[0], rel=0.15)


@pytest.mark.slow
def test_masks_decide_in_blocks_as_in_the_whole_scene(inside, tmp_path):
    """The level of detail around a block is decided on, too: if it stayed, 6 % fewer would be left, and 2 dB
    be lost."""
    room, photographs = inside
    plan = prune_settings("svr", 200, 60, full=False, lambda_f=1e-3, mask_init=1.0)
    quality = PhotographLikeness(photographs, BlockRasterizer).psnr
    (_, whole), (_, parts) = (
        learned(room, photographs, tmp_path / str(most), most, plan) for most in (6_000, 1_500)
    )
    assert 1_000 < whole.count < 3_000 and len(parts.blocks) == 4
    assert parts.count == pytest.approx(whole.count, rel=0.03) and quality(parts) > quality(whole) - 0.5


def test_a_run_that_removes_decides_of_its_own_gaussians_alone(tiny, data):
    """The others stay as they are."""
    scene, own = read_scene(tiny.splat), (40, 100)
    plan = prune_settings("removal", 30, 0, full=False, lambda_f=0.5)
    model = run_of(scene, data, replace(plan, own=own, target=scene.count - 40))
    others = (model.origin < own[0]) | (model.origin >= own[1])
    for name in PARAMETERS:
        moved = (
            (getattr(model, name) != getattr(scene, name)[model.origin]).reshape(model.count, -1).any(axis=1)
        )
        assert not moved[others].any() and moved[~others].mean() > 0.9, name
    assert model.count == scene.count - 40 and others.sum() == scene.count - 60


@pytest.mark.parametrize("target", [25, 10])
def test_the_target_of_masks_is_of_the_own_gaussians(tiny, data, target):
    """The others are decided on with the same weights."""
    scene, own = read_scene(tiny.splat), (40, 100)
    plan = prune_settings("svr", 200, 0, full=False, lambda_f=1e-2, mask_init=2.0)
    model = run_of(scene, data, replace(plan, own=own, target=target))
    inside = (model.origin >= own[0]) & (model.origin < own[1])
    assert inside.sum() == target
    assert (~inside).sum() == pytest.approx(target * (scene.count - 60) / 60, rel=0.5)


def run_of(scene: Scene, data: Dataset, plan: Plan) -> Model:
    """What is left after all steps, on a SIMD level that gives the same on every processor that has it."""
    level = "baseline" if "baseline" in supported_levels() else "neon"
    return to_the_end(Run(Model.of(scene), data, plan, NativeEngine(level))).model


@pytest.mark.slow
def test_a_block_that_no_view_sees_keeps_a_gaussian(tiny, data, tmp_path):
    """As much as memory would keep, but one: no block is empty."""
    scene = replace(read_scene(tiny.splat), attributes={}, property_order=())
    far = replace(scene.select(np.arange(20)), means=scene.means[:20] + np.array([0, 50, 0], np.float32))
    both = replace(
        scene, **{name: np.concatenate([getattr(scene, name), getattr(far, name)]) for name in PARAMETERS}
    )
    write_scene(tmp_path / "far.ply", both)
    plan = prune_settings("svr", 20, 10, full=False, min_contribution=0.02)
    left, recovered = learned(replace(tiny, splat=tmp_path / "far.ply"), data, tmp_path / "work", 20, plan)
    lonely = [block.count for block in left.blocks if (block.geometry[:, 1] > 40).all()]
    assert lonely and set(lonely) == {1} and recovered.count == left.count


@pytest.mark.slow
def test_steps_on_any_number_of_machines_give_the_bytes_of_one(tiny, tmp_path, svrgs):
    words = ["--data", tiny.folder, "--method", "removal", *STEPS, "--block", 70]
    one = svrgs(
        "large", "prune", tiny.splat, *words, "--target", 0.4, "--out", tmp_path / "one.ply", "--json"
    ).json
    assert one["after"]["count"] == 100 and one["method"] == "removal" and one["before"]["psnr"] > 15
    assert one["views"] == 10
    assert not list(tmp_path.glob("*.blocks"))
    work = tmp_path / "work"
    steps = [
        ["divide", tiny.splat, *words, "--work", work],
        ["score", work],
        ["reduce", work],
        ["merge", work],
        ["cut", work],
    ]
    steps += [["decide", work, "--part", part, "--parts", 3, "--target", 0.4] for part in (2, 0, 1, 0)]
    steps += [["tune", work, "--part", part, "--parts", 2] for part in (1, 0)] + [
        ["finish", work, "--out", tmp_path / "many.ply"]
    ]
    done = [svrgs("large", *step) for step in steps]
    assert all(step.status == 0 for step in done), [step.err for step in done if step.status]
    assert "dB against the photographs, the original" in done[-1].out
    assert (tmp_path / "many.ply").read_bytes() == (tmp_path / "one.ply").read_bytes()
    fewer = [
        svrgs("large", *step)
        for step in (
            ["decide", work, "--target", 0.2],
            ["tune", work],
            ["finish", work, "--out", tmp_path / "few.ply"],
        )
    ]
    # nothing of the first decision is left
    assert all(step.status == 0 for step in fewer) and read_scene(tmp_path / "few.ply").count == 50


@pytest.mark.slow
def test_an_allowed_drop_on_photographs_decides_how_many_stay(inside, tmp_path, svrgs):
    room, photographs = inside
    scene = read_scene(room.splat)
    # photographs are not its own pictures
    scene.sh[:, 0] += np.random.default_rng(1).normal(0, 0.15, scene.sh[:, 0].shape)
    write_scene(tmp_path / "a.ply", scene)
    same = f"{tmp_path}/a.ply --data {room.folder} --method removal --iterations 30 --recovery 60".split()
    words = ["large", "prune", *same, "--block", 2_000, "--json"]
    little, much = (
        svrgs(*words, "--max-drop", drop, "--out", tmp_path / f"{drop}.ply").json | {"allowed": drop}
        for drop in (0.5, 4)
    )
    assert 300 < much["after"]["count"] < 0.9 * little["after"]["count"] < 0.9 * 6_000
    for result in (little, much):
        assert result["drop"] == pytest.approx(result["before"]["psnr"] - result["psnr"])
        assert result["blocks"] == 4
        # what measures shows parts of the room that what decides does not show
        assert f"more than the {result['allowed']} dB that were allowed" in result["notes"][0]
    decide = quality_views(hold_apart(photographs))
    before, after = (
        evaluate(read_scene(path), photographs, decide, Rasterizer())["psnr"]
        for path in (tmp_path / "a.ply", tmp_path / "0.5.ply")
    )
    assert after > before - 0.5
    whole = svrgs("prune", *same, "--max-drop", 4, "--out", tmp_path / "4.ply")
    assert "more than the 4 dB that were allowed" in whole.out
    coarse = svrgs(*words, "--max-drop", 0.001, "--out", tmp_path / "o.splat")
    assert coarse.status == 2 and "the format alone loses" in coarse.err
    masked = svrgs(*words, "--method", "svr", "--max-drop", 0.5, "--out", tmp_path / "o.ply")
    assert masked.status == 2
    assert "--max-drop by blocks is for removal and saliency, not for 'svr'" in masked.err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["0.5.ply", "4.ply", "a.ply"]


def test_a_job_that_has_begun_its_steps_does_not_begin_again_by_blocks(tiny, tmp_path, svrgs, monkeypatch):
    def short(*_):
        raise SHORT

    monkeypatch.setattr(pipeline.FineTuned, "tune", short)
    words = ["--data", tiny.folder, *STEPS, "--out", tmp_path / "o.ply", "--target", 0.5]
    result = svrgs("prune", tiny.splat, *words)
    assert result.status == 2 and str(SHORT) in result.err and not (tmp_path / "o.ply").exists()


def test_a_job_on_photographs_goes_over_to_blocks_where_memory_is_short(
    tiny, tmp_path, svrgs, monkeypatch, caplog
):
    def short(*_):
        raise SHORT

    monkeypatch.setattr(pipeline.FineTuned, "open", short)
    words = ["--data", tiny.folder, *STEPS, "--out", tmp_path / "o.spz"]
    result = svrgs("prune", tiny.splat, *words, "--target", 0.5, "--json").json
    assert result["count"] == result["after"]["count"] == COUNT // 2 and result["method"] == "removal"
    assert result["blocks"] == 1
    assert result["before"]["count"] == COUNT and result["before"]["psnr"] > 15
    assert "so it was pruned by blocks" in result["notes"][0]
    assert "svrgs large" not in caplog.text and [path.name for path in tmp_path.iterdir()] == ["o.spz"]
    done = svrgs(
        "prune", tiny.splat, *words, "--method", "svr", "--visible-mask", "--report", tmp_path / "page"
    )
    assert done.status == 0 and "before  250 Gaussians, PSNR" in done.out
    assert "of the Gaussians at" in done.out
    page = (tmp_path / "page" / "index.html").read_text()
    assert "method svr" in page and "so it was pruned by blocks" in page and page.count("data:image/") > 5
    assert "Over the iterations" not in page
    blocked = svrgs("prune", tiny.splat, *words, "--target", 0.5, "--report", tiny.splat)
    assert blocked.status == 2 and str(tiny.splat) in blocked.err
    said: list[str] = []
    options = PruneOptions(
        scene=tiny.splat,
        out=tmp_path / "o.ply",
        data=tiny.folder,
        target=0.5,
        iterations=20,
        recovery=10,
        quiet=True,
    )
    pipeline.prune_scene(options, lambda job: replace(job, part=lambda text, _: said.append(text)))
    assert any(text.startswith("decide: block 0, 125 Gaussians: Removing") for text in said)
    assert any(text.startswith("recover: ") for text in said)
    refused = svrgs("prune", tiny.splat, *words, "--method", "svr")
    assert refused.status == 2
    assert "with --visible-mask, or with removal to a number or an allowed drop," in refused.err
    assert "it would be pruned by blocks" in refused.err
    other = svrgs("prune", tiny.splat, *words, "--method", "maskgs")
    assert other.status == 2 and other.err.count("svrgs large prunes it by blocks") == 1


def test_a_job_of_blender_goes_over_to_blocks_too_and_tells_what_it_does(tiny, tmp_path, monkeypatch):
    class Listener:
        said: list[str] = []  # noqa: RUF012

        def tell(self, kind: str, **facts):
            pass

        def progress(self, stage: str, label: str, **facts):
            assert stage == "looping", "so a stop saves a checkpoint"
            self.said.append(label)

    def short(*_):
        raise SHORT

    monkeypatch.setattr(pipeline.FineTuned, "open", short)
    folder = create(tmp_path / "job", tiny, method="removal", iterations=20, recovery=10, target=0.5)
    recorder = PruneRecorder(folder, Listener())
    result = recorder.finish(pipeline.prune_scene(folder.options(), recorder.attached))
    assert any(text.startswith("decide: block 0") for text in Listener.said)
    assert result["merged"] and result["count"] == COUNT // 2 and result["before"]["psnr"] > 15
    assert read_scene(folder / "pruned.ply").count == COUNT // 2
    assert not list((tmp_path / "job").glob("*.blocks"))


def test_photographs_of_another_capture_are_told(tiny, tmp_path, svrgs, caplog):
    other = tmp_path / "other"
    shutil.copytree(tiny.folder, other)
    names = sorted((other / "images").iterdir())
    contents = [path.read_bytes() for path in names]
    for path, bytes_ in zip(names, contents[5:] + contents[:5], strict=True):
        path.write_bytes(bytes_)
    with caplog.at_level(logging.WARNING):
        result = svrgs(
            f"large prune {tiny.splat} --data {other} --method svr",
            *STEPS,
            f"--force --out {tmp_path}/o.ply --json",
        ).json
    assert "explains only 16% of the photographs" in " ".join(result["notes"])


@pytest.mark.parametrize(
    ("words", "sentence"),
    [
        (["--method", "svr"], "--method decides on photographs: add --data"),
        (
            ["--data", "DATA", "--method", "maskgs"],
            "'maskgs' needs the scene in memory; by blocks, choose one of removal, svr, ",
        ),
        (["--data", "DATA", "--method", "nothing"], "'nothing' is unknown"),
        (["--data", "DATA", "--method", "svr", "--iterations", 0], "give --iterations a number above 0"),
        (["--data", "DATA", "--method", "svr", "--steps", 5], "leave them out, or --method"),
        (["--data", "DATA", "--method", "svr", "--levels", "0.5"], "leave them out, or --method"),
        (["--data", "DATA", "--method", "svr", "--holdout", 1], "all views of the dataset are held out"),
        (
            ["--data", "DATA", "--target", 0.5, "--recovery", 5],
            "--recovery is for methods that decide on photographs: add --method",
        ),
        (["--data", "DATA/sparse/0", "--method", "svr"], "has no image folder images"),
        ([], "add --target, --target-count or --max-drop"),
    ],
)
def test_what_does_not_go_together_is_refused_before_anything_is_written(
    tiny, tmp_path, svrgs, words, sentence
):
    if "DATA/sparse/0" in words:
        shutil.copytree(tiny.folder / "sparse", tmp_path / "model/sparse")
    given = [
        str(word).replace("DATA/sparse/0", str(tmp_path / "model")).replace("DATA", str(tiny.folder))
        for word in words
    ]
    done = svrgs("large", "prune", tiny.splat, *given, "--out", tmp_path / "o.ply")
    assert done.status == 2 and sentence in done.err and done.err.count("\n") == 1, done.err
    assert not (tmp_path / "o.ply").exists() and not list(tmp_path.glob("*.blocks"))


def test_steps_that_lack_something_say_what(tiny, data, tmp_path, svrgs):
    work = tmp_path / "work"
    assert (
        svrgs("large", "divide", tiny.splat, "--data", tiny.folder, "--work", work, "--block", 70).status == 0
    )
    assert "was divided without --method" in svrgs("large", "decide", work).err
    assert "add --target or --target-count" in svrgs("large", "cut", work).err
    words = f"--data {tiny.folder} --method svr --iterations 20 --recovery 10 --work {work} --block 70"
    assert svrgs("large", "divide", tiny.splat, words).status == 0
    assert "is not there; merge the block 0 first" in svrgs("large", "cut", work).err
    assert all(svrgs("large", step, work).status == 0 for step in ("score", "reduce", "merge", "cut"))
    assert "block 0 is missing; do the step before it first" in svrgs("large", "tune", work).err
    assert svrgs("large", "decide", work).status == 0
    assert "--recovery of svrgs large divide" in svrgs("large", "tune", work, "--steps", 5).err
    (work / FILE).write_text("{}")
    with pytest.raises(FormatError, match="divide the scene again"):
        Request.read(work)
    assert svrgs("large", "decide", work).err.count("\n") == 1


def test_a_request_comes_back_as_it_was_written(tmp_path):
    asked = {"data": tmp_path / "data", "method": "svr", "lambda_f": 0.5, "background": (1.0, 0.5, 0.0)}
    request = Request.of(PruneOptions(**asked, iterations=30, recovery=20, holdout=4))
    request.write(tmp_path)
    assert Request.read(tmp_path) == request and Request.read(tmp_path / "no") is None
    assert set(methods()) == {"removal", "saliency", "svr", "svr-a", "svr-b", "svr-even", "svr-self"}
    assert not request.plan().full
    assert json.loads((tmp_path / FILE).read_text())["method"] == "svr"
    with pytest.raises(SceneError, match="choose one of"):
        Request.of(replace(request.options, method="opacity"))


def test_targets_of_blocks_are_the_number_together(tiny, tmp_path):
    assert targets(divide(tiny.splat, tmp_path, 70), 0) == [0, 0, 0, 0]
