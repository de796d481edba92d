"""`svrgs prune` of scenes that are too large to be read as a whole: it goes over to blocks, and says so."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from scenes import ball
from svrgs_addon.files import ply
from svrgs_addon.files.registry import load_scene, read_scene, size_on_disk, write_scene
from svrgs_addon.files.streamed_sog import read_level
from svrgs_addon.finetune.decimate.order import hidden, visibility_sums
from svrgs_addon.finetune.viewed_scene import ViewedScene, reduced
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import by_blocks, job_views, pipeline, plans
from svrgs_addon.prune.belonging import check_seen, seen_of
from svrgs_addon.prune.blocks.request import Request
from svrgs_addon.prune.blocks.sample import MAX_SAMPLED, finer, sample_of
from svrgs_addon.prune.blocks.tuning import tune
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.recipes.by_blocks import Goal
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.system import memory
from svrgs_addon.system.errors import SceneError
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_addon.views.rig import place_rig, viewpoints
from svrgs_addon.views.rig.around import cameras_around
from svrgs_addon.views.rig.place import Rig
from svrgs_bench.scenes import orbit_camera, room

COUNT = 3_000


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("object") / "ball.ply"
    write_scene(path, ball(COUNT))
    return path


@pytest.fixture
def short(monkeypatch):
    """As if memory sufficed for no scene as a whole."""
    monkeypatch.setattr(memory, "decimating", lambda *_: 10**15)
    monkeypatch.setattr(memory, "ordering", lambda *_: 10**15)


@pytest.fixture(autouse=True)
def few_views(small_rig, monkeypatch):
    monkeypatch.setattr(job_views, "PLACED_FOR_QUICK", 12)


@pytest.mark.slow
def test_a_quick_job_goes_over_to_blocks_where_memory_is_short(svrgs, short, source, tmp_path, caplog):
    result = svrgs("prune", source, "--quick", "--target", 0.25, "--out", tmp_path / "o.spz", "--json").json
    assert result["count"] == result["after"]["count"] == COUNT // 4 and result["before"]["count"] == COUNT
    assert result["views"] == job_views.PLACED_FOR_QUICK
    assert result["psnr"] > 25 and result["ssim"] > 0.8 and 0 < result["flip"] < 0.2 and result["blocks"] == 1
    assert read_scene(tmp_path / "o.spz").count == COUNT // 4
    assert result["bytes"] == (tmp_path / "o.spz").stat().st_size
    assert "of memory" in result["notes"][0] and "pruned by blocks" in result["notes"][0]
    assert "it is pruned by blocks" in caplog.text
    assert [path.name for path in tmp_path.iterdir()] == ["o.spz"], "the blocks are removed"


@pytest.mark.slow
def test_advice_that_is_followed_is_not_given(svrgs, monkeypatch, source, tmp_path):
    monkeypatch.setattr(memory, "reading", lambda _: 10**15)
    note = svrgs("prune", source, "--quick", "--target", 0.25, "--out", tmp_path / "o.ply", "--json").json[
        "notes"
    ][0]
    assert "reading it needs" in note and "are available; so it was pruned by blocks" in note
    assert "svrgs large" not in note


def test_outputs_are_checked_before_cameras_are_placed(svrgs, monkeypatch, source, tmp_path):
    monkeypatch.setattr(
        "svrgs_addon.prune.job_views.place_rig", lambda *_, **__: pytest.fail("cameras were placed")
    )
    assert "is the input itself" in svrgs("large", "prune", source, "--target", 0.5, "--out", source).err
    (tmp_path / "work").mkdir()
    (tmp_path / "work/mine.txt").write_text("mine")
    assert (
        "holds no blocks"
        in svrgs(f"large prune {source} --target 0.5 --out {tmp_path}/o.ply --work {tmp_path}/work").err
    )


@pytest.mark.slow
def test_the_text_of_the_result_has_no_time_per_frame(svrgs, short, source, tmp_path):
    said = svrgs("prune", source, "--quick", "--target", 0.25, "--out", tmp_path / "o.ply").out
    assert "PSNR" in said and "ms per frame" not in said and "by blocks" in said


@pytest.mark.slow
def test_a_merge_without_photographs_goes_over_to_blocks_too(svrgs, short, source, tmp_path):
    result = svrgs("prune", source, "--target-count", 700, "--out", tmp_path / "o.ply", "--json").json
    assert result["count"] == 700 and result["views"] > job_views.PLACED_FOR_QUICK


@pytest.mark.slow
def test_the_share_that_is_done_is_that_of_the_whole_job(short, source, tmp_path):
    told: list[tuple[str, float]] = []
    options = PruneOptions(
        scene=source, out=tmp_path / "o.ply", quick=True, target=0.5, levels=(0.5, 0.2), quiet=True
    )
    pipeline.prune_scene(
        options, lambda job: replace(job, part=lambda text, share: told.append((text, share)))
    )
    shares = [share for _, share in told]
    assert shares == sorted(shares) and len(set(shares)) > 50 and 0.9 < shares[-1] < 1
    steps = "divide score merge cut tune original compare read measure"
    assert {text.split(":")[0] for text, _ in told} == {*steps.split()}


@pytest.mark.slow
def test_a_file_with_more_gaussians_than_are_read_as_a_whole_is_pruned_by_blocks(
    svrgs, monkeypatch, source, tmp_path
):
    monkeypatch.setattr(ply.read_ply, "__defaults__", (COUNT - 1,))
    result = svrgs("prune", source, "--quick", "--target", 0.5, "--out", tmp_path / "o.ply", "--json").json
    assert result["count"] == COUNT // 2 and "more than the limit" in result["notes"][0]


@pytest.mark.slow
def test_given_cameras_alone_count_where_that_is_asked_for(svrgs, short, source, tmp_path):
    rig = place_rig(load_scene(source), views=6)
    write_cameras_json(tmp_path / "views.json", rig.cameras)
    words = ["--cameras", tmp_path / "views.json", "--seen-from-only"]
    result = svrgs("prune", source, "--target", 0.5, *words, "--out", tmp_path / "o.ply", "--json").json
    assert result["views"] == 6 and any("of views.json alone" in note for note in result["notes"])


def test_the_cameras_of_a_dataset_are_taken_for_a_quick_job(svrgs, short, tiny, tmp_path):
    result = svrgs(
        f"prune {tiny.splat} --data {tiny.folder} --quick --target 0.5 --out {tmp_path}/o.ply", "--json"
    ).json
    assert result["count"] == round(result["before"]["count"] / 2)
    assert result["views"] < job_views.PLACED_FOR_QUICK
    assert result["notes"][1:] == ["10 views see 91% of the Gaussians"]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_a_drop_is_held(svrgs, short, source, tmp_path, suffix):
    out = tmp_path / f"o{suffix}"
    result = svrgs("prune", source, "--quick", "--max-drop", 0.4, "--out", out, "--json").json
    assert 0 < result["drop"] <= 0.4 and COUNT / 20 <= result["count"] < COUNT
    assert read_scene(out).count == result["count"]
    assert "pruned by blocks" in result["notes"][0]
    assert [path.name for path in tmp_path.iterdir()] == [out.name]
    if suffix == ".spz":
        return
    assert abs(result["psnr_values"] - result["psnr"]) < 0.01
    assert not any("format" in note for note in result["notes"])
    wide = svrgs(
        "prune", source, "--quick", "--max-drop", 1.5, "--out", tmp_path / f"wide{suffix}", "--json"
    ).json
    assert wide["count"] < result["count"] and result["drop"] < wide["drop"] <= 1.5


@pytest.mark.slow
def test_a_drop_that_the_format_alone_exceeds_is_refused_before_views_are_scored(
    svrgs, short, monkeypatch, source, tmp_path
):
    monkeypatch.setattr(
        "svrgs_addon.prune.recipes.by_blocks.score", lambda *_: pytest.fail("views were scored")
    )
    done = svrgs("prune", source, "--quick", "--max-drop", 1e-4, "--out", tmp_path / "o.spz")
    assert done.status == 2 and "the format alone loses" in done.err and not any(tmp_path.iterdir())


@pytest.mark.slow
def test_levels_are_files_of_their_own(svrgs, short, source, tmp_path):
    result = svrgs(f"prune {source} --quick --target 0.5 --levels 0.5,0.2 --out {tmp_path}/o.spz --json").json
    assert result["count"] == COUNT // 2
    assert [level["count"] for level in result["levels"]] == [COUNT // 4, COUNT // 10]
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.spz", "o_20.spz", "o_50.spz"]
    for level in result["levels"]:
        path = Path(level["out"])
        assert read_scene(path).count == level["count"] and level["bytes"] == path.stat().st_size
        assert 15 < level["psnr"] < result["psnr"]


@pytest.mark.slow
def test_without_a_number_the_result_is_the_whole_scene(svrgs, short, monkeypatch, source, tmp_path):
    monkeypatch.setattr(
        "svrgs_addon.prune.recipes.by_blocks.tune",
        lambda divided, *_: tuned.append(divided) or tune(divided, *_),
    )
    tuned = []
    result = svrgs("prune", source, "--quick", "--levels", "0.3", "--out", tmp_path / "o.ply", "--json").json
    assert result["count"] == COUNT and result["psnr"] > 60
    assert result["levels"][0]["count"] == round(0.3 * COUNT) and len(tuned) == 1


@pytest.mark.slow
def test_levels_of_a_streamed_sog_are_in_it(svrgs, short, source, tmp_path):
    out = tmp_path / "web/lod-meta.json"
    result = svrgs(
        "prune", source, "--quick", "--target", 0.5, "--levels", "0.2", "--out", out, "--json"
    ).json
    assert [sum(part.count for part in read_level(out, level)) for level in range(2)] == [
        COUNT // 2,
        COUNT // 10,
    ] and not any(out.parent.glob("*.blocks"))
    assert result["out"] == result["levels"][0]["out"] == str(out)
    assert result["levels"][0]["count"] == COUNT // 10
    assert result["bytes"] + result["levels"][0]["bytes"] + out.stat().st_size == size_on_disk(out)
    assert result["psnr"] > result["levels"][0]["psnr"]


def test_a_full_disk_is_told_before_views_are_scored(svrgs, short, monkeypatch, source, tmp_path):
    monkeypatch.setattr(
        "svrgs_addon.prune.recipes.by_blocks.score", lambda *_: pytest.fail("views were scored")
    )
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=4 * COUNT * (12 + 3 * 4) * 2))
    done = svrgs("prune", source, "--quick", "--target", 0.9, "--out", tmp_path / "o.ply")
    assert done.status == 2 and "are free; free disk space or choose another folder" in done.err
    assert not any(tmp_path.iterdir())


def test_scores_and_pictures_have_room_before_the_first_view(svrgs, monkeypatch, source, tmp_path):
    assert svrgs("large", "divide", source, "--work", tmp_path / "w").status == 0
    monkeypatch.setattr("shutil.disk_usage", lambda _: SimpleNamespace(free=90 * COUNT))  # 80 of scores
    done = svrgs("large", "score", tmp_path / "w")
    assert done.status == 2 and "are free; free disk space or choose another folder" in done.err
    assert not list((tmp_path / "w").glob("*.picture.npy"))


@pytest.mark.slow
def test_a_format_that_loses_more_than_pruning_is_told(svrgs, source, tmp_path):
    scene = load_scene(source)
    scene.sh[:] += np.random.default_rng(0).normal(0, 0.2, scene.sh.shape)
    write_scene(tmp_path / "noise.ply", scene)
    done = svrgs("large", "prune", tmp_path / "noise.ply", "--target", 0.9, "--out", tmp_path / "o.splat")
    assert done.status == 0 and "the format of the output loses more than pruning" in done.out


def test_a_level_that_is_the_input_is_refused(svrgs, short, source, tmp_path):
    (tmp_path / "o_50.ply").write_bytes(source.read_bytes())
    done = svrgs(f"large prune {tmp_path}/o_50.ply --target 0.5 --levels 0.5 --out {tmp_path}/o.ply")
    assert done.status == 2 and "is the input itself" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["o_50.ply"]


@pytest.mark.parametrize("words", [["--max-drop", 0.5], ["--target", 0.5, "--method", "opacity"]])
def test_what_blocks_cannot_do_is_refused_as_before(svrgs, monkeypatch, short, source, tmp_path, words):
    monkeypatch.setattr(memory, "tuning", lambda *_: 10**15)
    done = svrgs("prune", source, *words, "--out", tmp_path / "o.ply")
    assert done.status == 2 and done.err.count("svrgs large prunes it by blocks") == 1
    assert not any(tmp_path.iterdir())
    monkeypatch.setattr(ply.read_ply, "__defaults__", (COUNT - 1,))
    many = svrgs("prune", source, *words, "--out", tmp_path / "o.ply")
    assert many.status == 2 and "more than the limit" in many.err
    assert many.err.count("svrgs large prunes it by blocks") == 1


def test_a_stop_leaves_nothing_behind(svrgs, short, stop_at, source, tmp_path):
    stop_at("score")
    done = svrgs("prune", source, "--quick", "--target", 0.5, "--out", tmp_path / "o.ply")
    assert done.status == 130 and "nothing was written" in done.err and not any(tmp_path.iterdir())


@pytest.mark.slow
def test_a_stop_between_levels_leaves_the_first_one(svrgs, short, stop_at, source, tmp_path):
    stop_at("measure")
    done = svrgs("prune", source, "--quick", "--target", 0.5, "--levels", "0.5", "--out", tmp_path / "o.ply")
    assert done.status == 130 and "the files that are there are complete" in done.err
    assert [path.name for path in tmp_path.iterdir()] == ["o.ply"]
    assert read_scene(tmp_path / "o.ply").count == COUNT // 2


def test_a_room_whose_inside_no_camera_sees_is_refused(source, tmp_path):
    closed = room(COUNT, 0)
    closed = replace(
        closed, opacity_logits=np.full(COUNT, 8, np.float32), log_scales=closed.log_scales + np.float32(1.5)
    )
    write_scene(tmp_path / "room.ply", closed)
    scene, _ = sample_of(tmp_path / "room.ply")
    with pytest.raises(SceneError, match=r"room.ply: 32 views see only \d+% of its Gaussians"):
        check_seen(
            seen_of(scene, cameras_around(scene, 32, 512, nearer=3.0)),
            str(tmp_path / "room.ply"),
            force=False,
        )
    seen = seen_of(sample_of(source)[0], place_rig(load_scene(source)).cameras)
    assert check_seen(seen, str(source), force=False) == []


@pytest.mark.slow
def test_cameras_are_placed_for_a_scene_that_is_too_large_too(svrgs, monkeypatch, source, tmp_path, caplog):
    monkeypatch.setattr(ply.read_ply, "__defaults__", (COUNT - 1,))
    result = svrgs(
        f"rig {source} --views 8 --out {tmp_path}/rig.json --preview {tmp_path}/rig.png --json"
    ).json
    assert result["views"] == 8 and (tmp_path / "rig.png").is_file()
    assert "placed by up to 500,000 of its Gaussians" in caplog.text


def test_a_sample_covers_about_what_all_gaussians_do(monkeypatch, source):
    monkeypatch.setattr("svrgs_addon.prune.blocks.sample.MAX_SAMPLED", COUNT // 2)
    scene, enlarged = sample_of(source)
    whole = load_scene(source)
    assert MAX_SAMPLED > COUNT and scene.count == COUNT // 2
    assert enlarged == pytest.approx((COUNT / scene.count) ** 0.5, rel=0.01)
    assert (scene.means == whole.means[:: round(enlarged**2)]).all()
    assert np.allclose(scene.log_scales, whole.log_scales[:: round(enlarged**2)] + np.log(enlarged))
    camera = cameras_around(whole, 1, 512)[0]
    alphas = [
        Rasterizer().forward(one, camera, render_options(one), outputs=("alpha",))["alpha"].mean()
        for one in (whole, scene)
    ]
    assert alphas[1] == pytest.approx(alphas[0], rel=0.12)


@pytest.mark.slow
def test_pictures_are_as_fine_as_all_gaussians_need(monkeypatch, source):
    whole = load_scene(source)
    small = replace(whole, log_scales=whole.log_scales - 3.5)
    monkeypatch.setattr(viewpoints, "LARGEST", 1024)
    sides = [place_rig(small, views=1, enlarged=factor).cameras[0].width for factor in (1.0, 1.2, 100.0)]
    assert sides[0] < sides[1] < sides[2] == 1024


@pytest.mark.slow
def test_placed_views_are_scored_at_the_size_that_they_need(source):
    camera = place_rig(load_scene(source), views=1).cameras[0]
    (scored,) = reduced(finer([camera]))
    assert scored.key == camera.key


def test_only_some_jobs_can_be_done_by_blocks(tmp_path):
    def possible(**given) -> bool:
        return by_blocks.possible(PruneOptions(scene=tmp_path / "a.ply", out=tmp_path / "b.ply", **given))

    assert possible(quick=True, target=0.5) and possible(target_count=5)
    assert possible(method="merge", target=0.5)
    assert possible(quick=True, max_drop=0.1) and possible(quick=True, target=0.5, levels=(0.5,))
    assert not possible(max_drop=0.1) and not possible(method="svr", target=0.5)
    assert not possible(target=0.5, levels=(0.5,)) and not possible(method="merge", max_drop=0.1)
    assert not possible(target=0.5, recovery=10) and not possible()
    assert plans.method_of(PruneOptions(target=0.5)).merges
    photographs = {"data": tmp_path, "iterations": 10}
    assert possible(**photographs, target=0.5) and possible(**photographs, visible_mask=True)
    assert possible(**photographs, method="svr", visible_mask=True)
    # F counts what is hidden, too
    assert not possible(**photographs) and not possible(**photographs, method="svr", target=0.5)
    assert not possible(**photographs, target=0.5, method="maskgs")
    assert not possible(**photographs, target=0.5, views_by_loss=True)
    assert possible(**photographs, max_drop=0.5) and not possible(**photographs, target=0.5, time=60.0)
    assert possible(**photographs, target=0.5, schedule=0.1)
    assert (
        Request.of(PruneOptions(data=tmp_path, iterations=300, recovery=500, schedule=0.1)).plan().total == 80
    )
    assert possible(**photographs, method="saliency", max_drop=0.5, visible_mask=True)
    # what its steps win back is not foreseen
    assert not possible(**photographs, method="svr", max_drop=0.5, visible_mask=True)


def test_hidden_gaussians_are_counted(source):
    scene = load_scene(source)
    camera = cameras_around(scene, 1, 512)[0]
    sums, _ = visibility_sums(ViewedScene.of(scene, [camera]), pictures=False)
    assert 0.1 * COUNT < hidden(sums) < COUNT, "a ball hides its other side"


def test_a_quick_job_by_blocks_places_a_known_number_of_views(monkeypatch):
    asked, rig = [], Rig([orbit_camera(64, 48)], [], False, None)
    monkeypatch.setattr(job_views, "place_rig", lambda *_, views, **__: asked.append(views) or rig)
    for quick in (True, False):
        job_views.by_blocks(PruneOptions(quick=quick), room(9), 1.0)
    assert asked == [job_views.PLACED_FOR_QUICK, None]


def test_views_that_are_placed_are_drawn_larger_and_given_ones_as_they_are(tmp_path, monkeypatch):
    given, placed = ([orbit_camera(64, 48, turn)] for turn in (0, 90))
    write_cameras_json(tmp_path / "views.json", [replace(given[0], name="a")])
    monkeypatch.setattr(job_views, "place_rig", lambda *_, **__: Rig(placed, [], False, None))
    found = job_views.by_blocks(PruneOptions(cameras=tmp_path / "views.json"), room(9), 1.0).train
    assert [camera.width for camera in found] == [64, 128]


def test_the_smallest_share_keeps_one_gaussian():
    assert [Goal(share=share).number(10) for share in (0.001, 0.25, 0.0)] == [1, 2, 10]
