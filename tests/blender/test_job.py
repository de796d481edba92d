"""Pruning in the background from the panel: start, follow, stop, go on, the result, and what becomes of
it."""

from __future__ import annotations

import re
import time

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import COUNT, LONG, SHORT, delete, drawn, evaluated_count, follow, marked, said, set_up


def test_a_job_run_to_its_end_marks_the_original_and_adds_the_recovered(pruned, bridge, results, watch, ply):
    original, result = pruned
    assert bridge.count(original) == COUNT and bridge.count(result) == 125 and result.name == "scene pruned"
    assert marked(bridge, original).sum() == COUNT - 125 and not marked(bridge, result).any()
    assert original.data.attributes["svrgs:score"].data_type == "FLOAT"
    assert original.hide_get() and not result.hide_get() and result.matrix_world == original.matrix_world
    (job,) = watch.jobs.values()
    assert (
        bridge.scene_from_object(result).means.tobytes()
        == ply.read_ply(job.folder / "pruned.ply").means.tobytes()
    )
    assert (
        bridge.scene_from_object(original).means.tobytes()
        == ply.read_ply(DATA / "tiny/scene.ply").means.tobytes()
    )
    assert bpy.context.object == result and not watch.tick()
    assert result.svrgs_share == pytest.approx(50)


def test_the_slider_shows_fewer_or_more_at_once(pruned, bridge):
    original, result = pruned
    score = bridge.values(original, "svrgs:score")
    for share in (0, 10, 30, 50, 51, 80, 100, 50):
        result.svrgs_share = share
        count = round(share / 100 * COUNT)
        left = ~marked(bridge, original)
        assert left.sum() == count
        assert not left.any() or left.all() or score[left].min() > score[~left].max()
        assert (~marked(bridge, result)).sum() == min(count, 125)
        shown = result if count <= 125 else original
        assert not shown.hide_get() and (original if shown is result else result).hide_get()
        assert evaluated_count(shown) == count, "what is marked is not shown"


@pytest.mark.parametrize("share", [20, 50, 70, 100])
def test_apply_keeps_what_is_shown(pruned, bridge, ply, share):
    original, result = pruned
    recovered, source = bridge.scene_from_object(result), bridge.scene_from_object(original)
    result.svrgs_share = share
    left, kept = ~marked(bridge, original), bridge.values(original, "svrgs:score") > 0.5
    bpy.ops.svrgs.apply()
    expected = np.where(kept[:, None], 0, source.means)
    expected[kept] = recovered.means
    final = bridge.scene_from_object(result)
    assert final.count == round(share / 100 * COUNT) == left.sum()
    assert (final.means == expected[left]).all() and final.sh.shape == (final.count, *source.sh.shape[1:])
    assert "removed" not in result.data.attributes and "removed" not in original.data.attributes
    assert not result.modifiers and not original.modifiers and original.hide_get() and not result.hide_get()
    assert bridge.count(original) == COUNT
    with pytest.raises(RuntimeError, match="not applied yet"):
        bpy.ops.svrgs.apply()


def test_the_original_stays_until_it_is_discarded(pruned):
    original, result = pruned
    with pytest.raises(RuntimeError, match="Apply the result first"):
        bpy.ops.svrgs.discard(what="ORIGINAL")
    bpy.ops.svrgs.apply()
    bpy.ops.svrgs.discard(what="ORIGINAL")
    assert list(bpy.data.objects) == [result]
    assert bpy.ops.svrgs.job_start.poll(), "what was pruned can be pruned again"


def test_a_result_that_does_not_please_is_discarded(pruned):
    original, _ = pruned
    bpy.ops.svrgs.discard(what="RESULT")
    assert list(bpy.data.objects) == [original] and not original.hide_get() and not original.modifiers
    assert "removed" not in original.data.attributes and bpy.context.object == original
    assert bpy.ops.svrgs.job_start.poll()


def test_a_result_deleted_with_x_leaves_the_original_free(pruned, bridge, results, watch):
    original, result = pruned
    source = bridge.scene_from_object(original).means.tobytes()
    delete(result)
    assert not original.hide_get() and not original.hide_render and not original.modifiers
    assert results.PRUNED not in original
    assert "removed" not in original.data.attributes
    assert bridge.scene_from_object(original).means.tobytes() == source
    bpy.context.view_layer.objects.active = original
    assert results.pair_of(original) == (None, None) and "load its result, or discard it" in drawn("prune")
    bpy.ops.svrgs.job_discard()
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: results.pruned_of(original))
    assert bridge.count(results.pruned_of(original)) == 125 and original.hide_get()


def test_undo_of_x_brings_the_pair_back(pruned, bridge, results):
    names, shown = [obj.name for obj in pruned], results.shown_count(pruned[1])
    bpy.ops.ed.undo_push(message="before")
    delete(pruned[1])
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    original, result = (bpy.data.objects[name] for name in names)
    assert results.pair_of(result) == results.pair_of(original) == (original, result)
    assert original.hide_get() and not result.hide_get() and results.shown_count(result) == shown == 125
    result.svrgs_share = 20
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 50


def test_an_original_deleted_with_x_leaves_a_result_that_can_be_applied(pruned, bridge, results):
    original, result = pruned
    original.hide_set(False)
    delete(original)
    bpy.context.view_layer.objects.active = result
    assert results.pair_of(result) == (None, result) and results.ORIGINAL not in result
    assert "Gaussians" in drawn("prune")
    result.svrgs_share = 40
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 50 and bpy.ops.svrgs.job_start.poll()


def test_probability_of_existence_is_an_attribute_where_masks_were_learned(pruned, bridge, watch):
    original, result = pruned
    (job,) = watch.jobs.values()
    learned, kept = bridge.values(original, "svrgs:probability"), job.folder.arrays()[0]
    assert learned.shape == (COUNT,) and (learned >= 0).all() and (learned <= 1).all()
    assert learned[kept].min() > 0
    np.testing.assert_array_equal(bridge.values(result, "svrgs:probability"), learned[kept])
    bpy.ops.svrgs.discard(what="RESULT")
    assert "svrgs:probability" not in original.data.attributes
    set_up({"method": "opacity", "recovery": 5})
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: len(bpy.data.objects) == 2)
    assert "svrgs:probability" not in original.data.attributes and "svrgs:score" in original.data.attributes


def test_compare_takes_what_apply_would_keep(pruned, results):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = pruned[1]
    for share, count in ((50, 125), (20, 50), (80, 200)):
        pruned[1].svrgs_share = share
        bpy.ops.svrgs.compare()
        rows = part("operators.view.compare").figures()
        assert (rows["original"]["count"], rows["pruned"]["count"]) == (COUNT, count)


def test_stopped_and_resumed(splat, watch):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    assert not bpy.ops.svrgs.job_start.poll() and "job_resume" not in drawn("prune")
    with pytest.raises(RuntimeError, match="'scene' does not wait to be resumed"):
        bpy.ops.svrgs.job_resume()
    follow(watch, lambda: job.facts.get("iteration", 0) > 200)
    bpy.ops.svrgs.job_stop()
    assert "Stop Now does not wait for it. Resume starts it from the beginning" in drawn("prune")
    assert "Stop Now" in drawn("prune")
    follow(watch, lambda: not job.running)
    saved = job.folder.checkpoint()
    assert job.state == "stopped" and saved > 200
    assert f"Stopped at {job.progress:.0%} Resume continues at {saved / 20_000:.0%}" in drawn("prune")
    assert not bpy.ops.svrgs.job_start.poll(), "what waits is resumed or discarded first"
    bpy.ops.svrgs.job_resume()
    follow(watch, lambda: job.facts.get("iteration", 0) > 0)
    assert job.facts["iteration"] > saved, "it goes on where it was stopped"
    with pytest.raises(RuntimeError, match="'scene' runs or waits: stop it first"):
        bpy.ops.svrgs.job_discard()
    bpy.ops.svrgs.job_stop(now=True)
    follow(watch, lambda: not job.running)
    assert job.state == "stopped" and job.folder.checkpoint() == saved
    bpy.ops.svrgs.job_discard()
    assert not job.folder.path.exists() and bpy.ops.svrgs.job_start.poll() and not watch.jobs


def test_a_job_with_a_limit_of_time_says_what_was_planned_and_keeps_to_it(splat, watch):
    set_up({"method": "removal", "goal": "SHARE", "share": 40, "use_time": True, "time": 3600})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration"))
    total, schedule = job.facts["total"], job.facts["schedule"]
    assert f"Planned for 3600 s: {schedule:.1%} of the steps, about " in drawn("prune")
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    bpy.ops.svrgs.job_resume()
    follow(watch, lambda: job.facts.get("iteration"))
    assert (job.facts["total"], job.facts["schedule"]) == (total, schedule)


def test_an_interrupted_job_is_found_when_the_file_is_opened_again(splat, watch, bridge, tmp_path):
    set_up(SHORT | {"iterations": 800})
    bpy.ops.svrgs.job_start()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration", 0) > 5)
    assert "If Blender closes, this job can be resumed later" in said()
    job._process.kill()
    follow(watch, lambda: not job.running)
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    assert not watch.jobs
    obj, found = watch.current(bpy.context)
    assert obj.name == "scene" and found is not job and found.state == "interrupted"
    bpy.ops.svrgs.job_resume()
    follow(watch, lambda: len(bpy.data.objects) == 2)
    assert bridge.count(bpy.context.object) == 125


def test_a_job_goes_on_while_another_file_is_open(splat, watch, tmp_path):
    set_up(SHORT | {"iterations": 800})
    bpy.ops.svrgs.job_start()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    (job,) = watch.jobs.values()
    bpy.ops.wm.read_homefile(use_empty=True)
    follow(watch, lambda: not job.running)
    assert job.state == "done" and not bpy.data.objects
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    assert watch.current(bpy.context)[1].state == "done"
    bpy.ops.svrgs.job_load()
    assert len(bpy.data.objects) == 2


def test_a_splat_edited_meanwhile_is_told_from_the_one_pruned(splat, watch, bridge):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    bridge.replace_gaussians(splat, bridge.scene_from_object(splat).select(np.arange(99)))
    (job,) = watch.jobs.values()
    follow(watch, lambda: not job.running)
    assert list(bpy.data.objects) == [splat]
    with pytest.raises(RuntimeError, match="99 Gaussians, but 250 when the job began"):
        bpy.ops.svrgs.job_load()


def test_without_a_dataset_the_button_says_what_to_do(splat):
    bpy.context.scene.svrgs_prune.data, bpy.context.scene.svrgs_prune.effort = "", "PHOTOGRAPHS"
    with pytest.raises(RuntimeError, match="Choose the dataset"):
        bpy.ops.svrgs.job_start()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    assert bpy.ops.svrgs.job_start.poll(), "that of the imported cameras"


def test_without_a_splat_the_buttons_say_what_to_do():
    for operator in (bpy.ops.svrgs.job_start, bpy.ops.svrgs.estimate):
        with pytest.raises(RuntimeError, match="Select a Gaussian splat first"):
            operator()
    with pytest.raises(RuntimeError, match="There is no job"):
        bpy.ops.svrgs.job_resume()


@pytest.mark.parametrize(
    "goal, target",
    [
        ({"goal": "SHARE", "share": 10}, 25),
        ({"goal": "COUNT", "count": 70}, 70),
        ({"goal": "COUNT", "count": 9999}, 250),
    ],  # fmt: skip
)
def test_targets_become_counts(splat, goal, target):
    set_up(goal)
    options = part("operators.jobs.job").options_of(bpy.context, splat)
    assert options["target_count"] == target and "lambda_f" not in options


def test_masks_exposure_and_poses_are_options_of_a_job_on_photographs_alone(splat, tmp_path):
    masks = {"masks": str(tmp_path), "invert_masks": True, "outside": "ignore", "exposure": "on"}
    masks |= {"refine_poses": "off"}
    options_of = part("operators.jobs.job").options_of
    assert options_of(bpy.context, splat)["outside"] == "auto"
    set_up(masks | {"effort": "PHOTOGRAPHS"})
    assert masks.items() <= options_of(bpy.context, splat).items()
    set_up({"effort": "QUICK"})
    assert not masks.keys() & options_of(bpy.context, splat).keys()
    set_up({"masks": "", "invert_masks": False, "outside": "auto", "effort": "PHOTOGRAPHS"})
    set_up({"exposure": "auto", "refine_poses": "auto"})


def test_a_loss_in_db_is_held(splat, watch, results, bridge):
    set_up({"goal": "DROP", "drop": 0.5, "holdout": 2, "iterations": 500, "recovery": 0})
    assert part("operators.jobs.job").options_of(bpy.context, splat)["max_drop"] == 0.5
    bpy.ops.svrgs.estimate()
    found = part("operators.jobs.estimate").of(splat)
    assert found["at_most"] and 0 < found["kept"] < COUNT
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: results.pruned_of(splat))
    result = results.pruned_of(splat)
    before, after = result[results.PSNR]
    assert bridge.count(result) < COUNT and before - after < 3  # measured on other photographs than the loss


@pytest.mark.parametrize(
    "options, sentence",
    [
        ({"goal": "DROP", "method": "opacity"}, "'Opacity' cannot prune to a loss"), ({"goal": "DROP",
        "iterations": 0}, "needs iterations"),
        ({"goal": "LAMBDA", "method": "pup"}, "'PUP 3D-GS' only ranks the Gaussians"),
    ],
)  # fmt: skip
def test_a_goal_that_the_method_cannot_reach_is_said(splat, options, sentence):
    set_up(options)
    assert sentence in drawn("prune")
    with pytest.raises(RuntimeError, match=sentence):
        bpy.ops.svrgs.job_start()


@pytest.mark.parametrize(
    "method, said",
    [("removal", "λ_F = 1e-4, the default"), ("lightgaussian", "Keeps 34%"), ("gns", "Keeps 25%"), ("maskgs",
    "The method's own weight decides")],
)  # fmt: skip
def test_without_a_target_the_panel_says_what_decides(splat, method, said):
    set_up({"goal": "LAMBDA", "method": method})
    assert said in " ".join(drawn("prune").split()) and ("amount" in drawn("prune")) == (method == "removal")
    assert "svrgs.set_lambda" not in drawn("prune")
    assert bpy.ops.svrgs.job_start.poll()


def test_the_values_of_the_paper_are_offered_for_its_method(splat):
    set_up({"goal": "LAMBDA", "method": "svr"})
    assert "svrgs.set_lambda" in drawn("prune")


def test_lambda_is_a_number_with_a_logarithmic_slider(splat):
    settings = bpy.context.scene.svrgs_prune
    bpy.ops.svrgs.set_lambda(value=1.25e-4)
    assert settings.lambda_f == pytest.approx(1.25e-4)
    assert settings.goal == "LAMBDA", "whoever sets λ_F wants it to count"
    for share, value in ((0.0, 1e-5), (0.5, 1e-4), (1.0, 1e-3)):
        settings.amount = share
        assert settings.lambda_f == pytest.approx(value) and settings.amount == pytest.approx(share)
    settings.method = "maskgs"
    assert "lambda_f" not in part("operators.jobs.job").options_of(bpy.context, splat)


def test_the_estimate_comes_before_anything_runs_and_soon(splat, capfd):
    set_up({"goal": "LAMBDA"})
    seconds = []
    for _ in range(2):  # a busy machine may be slow once
        started = time.monotonic()
        bpy.ops.svrgs.estimate()
        seconds.append(time.monotonic() - started)
    assert min(seconds) < 5
    found = part("operators.jobs.estimate").of(splat)
    assert found["count"] == COUNT and found["invisible"] == 10 and found["unseen"] >= 10
    assert 0 < found["kept"] <= COUNT - 10
    assert found["seconds"] > 0 and "would stay" in capfd.readouterr().out and len(bpy.data.objects) == 1


def test_an_estimate_that_cannot_be_made_says_why(splat):
    bpy.context.scene.svrgs_prune.data = str(DATA)
    with pytest.raises(RuntimeError, match=re.escape(f"{DATA}: holds no COLMAP model")):
        bpy.ops.svrgs.estimate()


def test_the_panel_draws_in_any_state(tmp_path, watch, monkeypatch):
    assert "Select a splat" in drawn("prune") and "Select the splat" in drawn("export")
    bpy.ops.object.camera_add()
    assert "Select a splat" in drawn("prune")
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.context.scene.svrgs_prune.data, bpy.context.scene.svrgs_prune.effort = "", "PHOTOGRAPHS"
    assert "Choose the dataset" in drawn("prune") and "250 Gaussians" in drawn("export")
    set_up(LONG | {"method": "removal", "data": str(DATA / "tiny"), "folder": str(tmp_path / "jobs")})
    for goal in ("LAMBDA", "SHARE", "COUNT", "SIZE"):
        bpy.context.scene.svrgs_prune.goal = goal
        assert "svrgs.job_start" in drawn("prune") and "svrgs.estimate" not in drawn("prune")
    bpy.ops.svrgs.job_start()
    assert "Starting" in drawn("prune")
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("psnr"))
    said = drawn("prune")
    assert "Gaussians, PSNR" in said and "left" in said and "svrgs.job_stop" in said
    pictures = part("operators.jobs.job_pictures")
    follow(watch, lambda: str(job.folder.path) in pictures._shown)  # there are no icons without a window
    assert tuple(pictures._pictures[0][pictures._shown[str(job.folder.path)]].image_size) == (64, 48)
    picture = pictures._pictures[0][str(job.folder.path)]
    # ground, grid and two lines
    assert len({tuple(pixel) for pixel in np.reshape(picture.image_pixels_float, (-1, 4)).round(2)}) == 4
    job._process.kill()
    follow(watch, lambda: not job.running)
    assert "Interrupted at" in drawn("prune") and "svrgs.job_discard" in drawn("prune")
    bpy.ops.svrgs.job_discard()
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: len(bpy.data.objects) == 3)
    assert "125 of 250 Gaussians" in drawn("prune")
    said = " ".join(drawn("prune").split())
    assert "Quality at 125 Gaussians: PSNR" in said and "not measured" not in said
    bpy.context.object.svrgs_share = 20
    said = " ".join(drawn("prune").split())
    assert "50 of 250 Gaussians" in said and "Quality at 125 Gaussians: PSNR" in said
    assert "not measured at this setting" in said
    bpy.context.object.svrgs_share = 60
    assert "25 more than were recovered" in drawn("prune")
    bpy.ops.svrgs.apply()
    assert "Discard Original" in drawn("prune") and splat.name in drawn("prune")


@pytest.mark.parametrize(
    "panel, said",
    [
        ("scene", "Select a splat"),
        ("compare", "side by side"),
        ("spatial_mask", "Refresh draws"),
        ("overlay", ""),
        ("engine", ""),
    ],
)
def test_every_panel_draws_without_anything_in_the_scene(panel, said):
    assert said in drawn(panel)
    bpy.ops.object.camera_add()
    assert said in drawn(panel)


@pytest.mark.parametrize("panel", ["prune", "compare", "spatial_mask", "overlay", "engine"])
def test_without_the_native_library_a_line_says_what_to_do(panel, splat, monkeypatch, tmp_path):
    native = part("svrgs_addon.native.library")
    (tmp_path / "other.so").write_bytes(b"of another computer")
    for library in ("nowhere.so", "other.so"):
        monkeypatch.setenv("SVRGS_LIBRARY", str(tmp_path / library))
        native.library.cache_clear()
        try:
            assert "install the extension's zip again" in drawn(panel).replace("  ", " ")
        finally:
            monkeypatch.undo()
            native.library.cache_clear()
