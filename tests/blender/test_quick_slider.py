"""The slider Keep on a quick result: any number of Gaussians is shown at once, by the order that the job has
kept."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import part
from job_helpers import drawn, ended, follow, set_up


@pytest.fixture
def splat(splat):
    """A splat without photographs."""
    bpy.context.scene.svrgs_prune.data = ""
    return splat


@pytest.fixture
def result(splat, watch, once):
    """100 of 250 Gaussians."""
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40})
    with once("quick"):
        bpy.ops.svrgs.job_start()
        (job,) = watch.jobs.values()
        follow(watch, lambda: ended(job))
    return bpy.context.object


@pytest.fixture
def listed_files(tmp_path):
    """How many finished jobs of the test would lose their files."""
    lists = part("operators.jobs.job_list")

    def count() -> int:
        lists.forget()
        found, _ = lists.finished_jobs(bpy.context)
        return sum(job.folder.path.is_relative_to(tmp_path) for job in found)

    return count


def said() -> str:
    return "\n".join(part("operators.jobs.prune_state").sentences(bpy.context))


def shown():
    """All Gaussians that a render shows."""
    return part("operators.data.visible_splats").splats(bpy.context.evaluated_depsgraph_get()).scene


def cached(obj):
    """What a viewport draws of the splat."""
    return part("operators.view.scene_cache").read(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def test_the_panel_says_what_the_job_notes_until_the_result_is_applied(result):
    note = "the other 36 are removed or merged first"
    # the column of rows is the job's own
    assert note in said() and "The quality is measured against" in said() and "svrgs_row" not in said()
    bpy.ops.svrgs.apply()
    assert note not in said() and not any(note in str(value) for value in result.values())


def test_it_shows_any_number_at_once_and_the_data_stay_those_of_the_job(result, bridge):
    assert "svrgs_share" in drawn("prune") and "prune_again" not in drawn("prune")
    own = bridge.scene_from_object(result).means
    assert cached(result).count == 100 and "not measured at this setting" not in said()
    for share, count in ((20, 50), (80, 200), (100, 240), (0, 3)):
        result.svrgs_share = share
        assert (
            cached(result).count
            == shown().count
            == part("operators.view.compare").shown_scene(result).count
            == count
        )
        assert f"{count} of 250 Gaussians" in said() and "not fine-tuned yet" in said()
        assert "pictures; not measured at this setting" in said() and "prune_again" in drawn("prune")
        assert (bridge.scene_from_object(result).means == own).all()
    result.svrgs_share = 40
    assert sorted(cached(result).means[:, 0]) == sorted(own[:, 0]) and "not fine-tuned yet" not in said()


def test_more_gaussians_look_more_like_the_original(result, splat, bridge):
    original = bridge.scene_from_object(splat)
    camera = part("svrgs_addon.views.rig.around").cameras_around(original, 8, 128)[3]
    native, psnr = part("svrgs_addon.native.rasterizer"), part("svrgs_addon.render.metrics").psnr
    draw = lambda scene: native.Rasterizer().forward(scene, camera)["rgb"].copy()
    whole, values = draw(original), []
    for share in (5, 30, 90):
        result.svrgs_share = share
        values.append(psnr(draw(cached(result)), whole))
    assert values[0] < values[1] < values[2]


def test_apply_keeps_what_is_shown(result, splat, bridge):
    result.svrgs_share = 70
    means = np.sort(cached(result).means, axis=0)
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 175
    assert (np.sort(bridge.scene_from_object(result).means, axis=0) == means).all()
    assert "svrgs_shown" not in result and not part("operators.jobs.job_result").undecided(result)
    assert bridge.count(splat) == 250
    assert shown().count == 175


def test_export_writes_what_is_shown(result, ply, tmp_path):
    result.svrgs_share = 20
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "out.ply"))
    assert ply.read_ply(tmp_path / "out.ply").count == 50
    assert "50 Gaussians, " in drawn("export") and "50 Gaussians, SH" in drawn("scene")


def test_the_export_dialog_counts_what_is_shown(result):
    count = part("operators.io.export_ply").SVRGS_OT_export_ply.count
    result.svrgs_share = 20
    assert count(SimpleNamespace(what="SEEN"), result) == 50
    assert count(SimpleNamespace(what="STORED"), result) == 100


def test_undo_brings_the_former_number_back(result):
    name = result.name
    result.svrgs_share = 20
    bpy.ops.ed.undo_push(message="before")
    result.svrgs_share = 80
    bpy.ops.ed.undo_push(message="after")
    bpy.ops.ed.undo()
    result = bpy.data.objects[name]
    assert result.svrgs_share == pytest.approx(20) and cached(result).count == 50


def test_a_saved_file_still_shows_it(result, tmp_path):
    name = result.name
    result.svrgs_share = 20
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "saved.blend"))
    result = bpy.data.objects[name]
    assert cached(result).count == 50
    result.svrgs_share = 60
    assert cached(result).count == 150


def test_the_result_moves_with_its_object_and_with_its_points(result, bridge):
    result.location.x += 5
    result.svrgs_share = 20
    assert cached(result).means.mean(axis=0) == pytest.approx(
        bridge.scene_from_object(result).means.mean(axis=0), abs=0.3
    )
    moved = bridge.values(result, "position") + np.array([0, 0, 7], np.float32)
    bridge.set_values(result, "position", "FLOAT_VECTOR", moved)
    result.svrgs_share = 30
    assert cached(result).means[:, 2].mean() == pytest.approx(moved[:, 2].mean(), abs=0.3)


def edit_points(result, bridge):
    moved = bridge.values(result, "position")
    moved[:40] += np.random.default_rng(0).normal(size=(40, 3)).astype(np.float32)
    bridge.set_values(result, "position", "FLOAT_VECTOR", moved)


def test_edited_points_keep_the_number_of_the_job(result, bridge):
    edit_points(result, bridge)
    result.svrgs_share = 20
    assert cached(result).count == 100 and "were edited" in said() and "100 of 250" in said()


def test_points_that_are_edited_while_another_number_is_shown_bring_that_of_the_job_back(result, bridge):
    result.svrgs_share = 20
    assert cached(result).count == 50
    edit_points(result, bridge)
    assert cached(result).count == shown().count == 100 and "were edited" in said() and "100 of 250" in said()
    assert "svrgs_share" not in drawn("prune")
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 100


def test_an_undo_of_the_edit_brings_the_slider_back(result, bridge):
    result.svrgs_share = 20
    bpy.ops.ed.undo_push(message="share")
    edit_points(result, bridge)
    bpy.ops.ed.undo_push(message="edit")
    assert cached(result).count == 100 and "were edited" in said()
    bpy.ops.ed.undo()
    result = bpy.context.object
    assert cached(result).count == 50 and "were edited" not in said() and "svrgs_share" in drawn("prune")


def test_without_the_order_the_viewport_shows_what_apply_writes(result, splat):
    result.svrgs_share = 20
    assert cached(result).count == 50
    (Path(part("operators.data.job_paths").folder_of(splat)) / "order.npy").unlink()
    assert cached(result).count == shown().count == 100


def test_delete_finished_keeps_the_files_of_a_result_that_shows_another_number(result, listed_files):
    assert listed_files() == 1
    result.svrgs_share = 20
    assert listed_files() == 0 and cached(result).count == 50


def test_modifiers_keep_the_number_of_the_job(result):
    result.svrgs_share = 20
    result.modifiers.new("mine", "NODES")
    assert "svrgs_share" not in drawn("prune") and "Remove the modifiers" in said() and "100 of 250" in said()


@pytest.mark.parametrize("name", ["order.npy", "merged.ply"])
def test_without_its_files_the_number_of_the_job_is_shown(result, splat, name):
    (Path(part("operators.data.job_paths").folder_of(splat)) / name).write_bytes(b"broken")
    result.svrgs_share = 20
    assert cached(result).count == 100 and "100 of 250" in said() and name in said()
    assert "svrgs_share" not in drawn("prune")
    (Path(part("operators.data.job_paths").folder_of(splat)) / "order.npy").unlink()
    assert "svrgs_share" not in drawn("prune") and "100 of 250" in said() and name not in said()


def test_the_order_can_be_read_before_it_is_needed(result, splat, monkeypatch):
    bridge_order = part("operators.data.quick_order")
    folder = Path(part("operators.data.job_paths").folder_of(splat))
    with monkeypatch.context() as patch:
        patch.setattr(bridge_order, "bpy", SimpleNamespace(app=SimpleNamespace(background=False)))
        bridge_order.read_ahead(part("svrgs_addon.jobs.job_folder").JobFolder(folder))
    (reading,) = bridge_order._ahead.values()
    reading.result(timeout=60)
    (folder / "order.npy").write_bytes(b"broken after it was read")
    result.svrgs_share = 20
    assert cached(result).count == 50 and not bridge_order._ahead


def test_selecting_asks_to_apply_first(result):
    assert bpy.ops.svrgs.select_gaussians.poll()
    result.svrgs_share = 20
    assert not bpy.ops.svrgs.select_gaussians.poll()


def test_fine_tune_prunes_again_to_what_is_shown(result, splat, watch, bridge):
    former = Path(part("operators.data.job_paths").folder_of(splat))
    result.svrgs_share = 20
    untuned = cached(result)
    bpy.ops.svrgs.prune_again()
    assert not former.exists() and bpy.context.object == splat and not splat.hide_get()
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    again = bpy.context.object
    assert again != splat and bridge.count(again) == 50 and again.svrgs_share == pytest.approx(20)
    assert "not fine-tuned yet" not in said()
    assert not np.array_equal(
        np.sort(bridge.scene_from_object(again).sh, axis=0), np.sort(untuned.sh, axis=0)
    )
    again.svrgs_share = 40
    assert cached(again).count == 100


def test_after_an_undo_of_fine_tune_the_former_result_has_its_own_number_and_no_slider(result, watch):
    result.svrgs_share = 20
    bpy.ops.ed.undo_push(message="slider")
    bpy.ops.svrgs.prune_again()
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    bpy.ops.ed.undo_push(message="result")
    name = bpy.context.object.name
    bpy.ops.ed.undo()
    former = bpy.data.objects[name]
    bpy.context.view_layer.objects.active = former
    assert cached(former).count == 100 and "100 of 250" in said() and "svrgs_share" not in drawn("prune")
