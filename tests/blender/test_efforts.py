"""The three efforts of pruning in the panel: quick, fine-tuned on the splat's own pictures, fine-tuned on
photographs."""

from __future__ import annotations

import re

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn, ended, follow, said, set_up


@pytest.fixture
def splat(splat):
    """A splat without photographs."""
    bpy.context.scene.svrgs_prune.data = ""
    return splat


def run(watch) -> bpy.types.Object:
    """Prunes with the settings of the panel; the result."""
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    return bpy.context.object


def test_without_photographs_the_choice_is_quick_and_with_them_they_are_chosen(splat):
    settings = bpy.context.scene.svrgs_prune
    assert settings.effort == "QUICK" and "data" not in drawn("prune") and bpy.ops.svrgs.job_start.poll()
    settings.data = str(DATA / "tiny")
    assert settings.effort == "PHOTOGRAPHS" and "data" in drawn("prune")
    settings.effort = "TUNED"
    settings.data = ""
    assert settings.effort == "TUNED"
    settings.effort = "PHOTOGRAPHS"
    assert not bpy.ops.svrgs.job_start.poll() and "Choose the dataset of the splat's photographs" in said()


@pytest.mark.parametrize("effort", ["QUICK", "TUNED"])
def test_the_result_stands_beside_the_original_until_it_is_applied(splat, bridge, watch, effort):
    set_up({"effort": effort, "goal": "SHARE", "share": 40, "recovery": 20})
    result = run(watch)
    assert result is not splat and bridge.count(result) == 100 and result.name == "scene pruned"
    assert splat.hide_get() and not result.hide_get()
    assert ("svrgs_share" in drawn("prune")) == (effort == "QUICK")
    assert "100 of 250 Gaussians" in said() and "against the original's own pictures" in said()
    assert not part("operators.jobs.job_result").undecided(splat)
    means = bridge.scene_from_object(result).means
    bpy.ops.svrgs.apply()
    assert (bridge.scene_from_object(result).means == means).all()
    assert not part("operators.jobs.job_result").undecided(result)
    assert splat.hide_get() and bridge.count(splat) == 250


def test_it_can_be_discarded(splat, bridge, watch):
    set_up({"effort": "QUICK", "goal": "COUNT", "count": 60})
    assert bridge.count(run(watch)) == 60
    bpy.ops.svrgs.discard(what="RESULT")
    assert list(bpy.data.objects) == [splat] and not splat.hide_get()
    assert "removed" not in splat.data.attributes
    assert bpy.ops.svrgs.job_start.poll()


def test_a_moved_original_moves_its_result(splat, bridge, watch):
    bpy.ops.svrgs.job_start.poll()
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 99})
    before = bridge.scene_from_object(splat).means.mean(axis=0)
    splat.location.x += 5
    result = run(watch)
    assert result.matrix_world == splat.matrix_world
    assert bridge.scene_from_object(result).means.mean(axis=0) == pytest.approx(before, abs=0.2)


def test_goals_that_quick_cannot_reach_say_so(splat):
    set_up({"effort": "QUICK"})
    set_up({"goal": "DROP", "iterations": 0})
    assert bpy.ops.svrgs.job_start.poll()
    assert "max_drop" in part("operators.jobs.job").options_of(bpy.context, splat)
    set_up({"goal": "LAMBDA"})
    assert not bpy.ops.svrgs.job_start.poll() and "Quick needs a number of Gaussians" in said()
    set_up({"effort": "TUNED"})
    assert bpy.ops.svrgs.job_start.poll()
    assert part("operators.jobs.job").options_of(bpy.context, splat)["method"] == "removal"


@pytest.mark.parametrize("effort", ["QUICK", "TUNED"])
def test_each_has_an_estimate(splat, effort):
    set_up({"effort": effort, "goal": "SHARE", "share": 20, "recovery": 100})
    bpy.ops.svrgs.estimate()
    assert "About 50 of 250 would stay" in said() and "views looked at" in said() and "not foreseen" in said()


def test_a_device_is_a_number_of_gaussians(splat):
    settings, devices = bpy.context.scene.svrgs_prune, part("operators.data.devices").DEVICES
    set_up({"effort": "QUICK", "goal": "DEVICE"})
    assert "device" in drawn("prune")
    for name, device in devices.items():
        settings.device, count = name, device.gaussians
        assert f"Keeps {count:,} Gaussians" in drawn("prune")
        assert part("operators.jobs.job").options_of(bpy.context, splat)["target_count"] == min(count, 250)
    assert [device.gaussians for device in devices.values()] == [
        400_000,
        400_000,
        150_000,
        1_000_000,
        3_000_000,
    ]


def test_the_estimate_for_a_device_says_how_many_gaussians_a_pixel_blends(splat):
    estimate = part("operators.jobs.estimate")
    for goal, said_it in (("SHARE", False), ("DEVICE", True)):
        set_up({"effort": "QUICK", "goal": goal})
        bpy.ops.svrgs.estimate()
        count, *others = estimate.line(splat).split(" · ")
        blended = round(estimate.of(splat)["overdraw_after"])
        assert count.startswith("≈ ") and (f"{blended} a pixel" in others) == said_it


def test_the_operator_prunes_without_photographs(splat, bridge, tmp_path):
    for more in ({"quick": True}, {"recovery": 20}, {"recovery": 20, "method": "opacity"}):
        bpy.context.view_layer.objects.active = splat
        bpy.ops.svrgs.prune(target=0.4, out=str(tmp_path / "out.ply"), overwrite=True, **more)
        assert bridge.count(bpy.context.object) == 100
    assert np.isfinite(bridge.scene_from_object(bpy.context.object).means).all()


# --- cameras of the file


@pytest.fixture
def shot(splat):
    """A camera that moves along a line on one side of the splat, looking at it."""
    middle = np.array(splat.matrix_world)[:3, :3] @ part("operators.data.splat_object").scene_from_object(
        splat
    ).means.mean(axis=0)
    bpy.ops.object.camera_add(location=middle + [0, -6, 0], rotation=(np.pi / 2, 0, 0))
    camera = bpy.context.object
    scene = bpy.context.scene
    scene.camera, scene.frame_start, scene.frame_end, scene.render.resolution_x = camera, 1, 10, 96
    scene.render.resolution_y = 64
    for frame, x in ((1, -0.5), (10, 0.5)):
        camera.location.x = middle[0] + x
        camera.keyframe_insert("location", frame=frame)
    scene.frame_set(3)
    bpy.context.view_layer.objects.active = splat
    return camera


def test_a_camera_path_is_a_set_of_views_in_the_coordinates_of_the_splat(splat, shot, bridge):
    views = part("operators.data.views_of_file").views(bpy.context, splat)
    assert len(views) == 10 and bpy.context.scene.frame_current == 3
    assert len({view.name for view in views}) == 10
    assert {(view.width, view.height) for view in views} == {(96, 64)}
    matrix = np.array(splat.matrix_world)
    for view in views:
        assert (matrix @ [*view.position, 1])[1] == pytest.approx(shot.matrix_world.translation.y, abs=1e-4)
    splat.scale = (1, 2, 1)
    bpy.context.view_layer.update()
    with pytest.raises(part("svrgs_addon.system.errors").SceneError, match="scaled unevenly"):
        part("operators.data.views_of_file").views(bpy.context, splat)


@pytest.mark.parametrize("views", ["ALSO", "ONLY"])
def test_cameras_of_the_file_count_in_a_job(splat, shot, bridge, watch, views):
    assert not re.search(r"\bviews\b", drawn("prune"))
    set_up({"effort": "TUNED", "views": views, "goal": "SHARE", "share": 40, "recovery": 20})
    assert re.search(r"\bviews\b", drawn("prune"))
    bpy.ops.svrgs.estimate()
    assert "About 100 of 250 would stay" in said()
    result = run(watch)
    (job,) = watch.jobs.values()
    facts = job.folder.result()["rig"]
    assert bridge.count(result) == 100 and facts["given"] == 10 and ("seen" in facts) == (views == "ALSO")


def test_without_a_camera_it_says_so(splat):
    bpy.context.scene.camera = None
    set_up({"effort": "TUNED", "views": "ONLY"})
    with pytest.raises(RuntimeError, match="this file has no camera whose views could count"):
        bpy.ops.svrgs.job_start()


# --- the placed cameras, as objects


def test_placed_cameras_are_children_of_the_splat_and_look_at_it(splat, bridge):
    splat.location.x += 3
    set_up({"effort": "TUNED"})
    assert "place_cameras" in drawn("prune")
    bpy.ops.svrgs.place_cameras()
    bridge_views = part("operators.data.views_of_file")
    placed = bridge_views.placed(splat)
    assert len(placed) > 12 and len(bpy.data.cameras) == len(placed) and bpy.context.object == splat
    bpy.context.view_layer.update()
    middle = np.array(splat.matrix_world) @ [*bridge.scene_from_object(splat).means.mean(axis=0), 1]
    towards = [
        (middle[:3] - obj.matrix_world.translation) @ -np.array(obj.matrix_world)[:3, 2] > 0 for obj in placed
    ]
    assert np.mean(towards) > 0.8
    bpy.ops.svrgs.place_cameras()
    assert len(bridge_views.placed(splat)) == len(bpy.data.cameras) == len(placed)
    assert len(bpy.data.collections) == 1


def test_a_job_uses_what_is_left_of_the_placed_cameras(splat, watch):
    set_up({"effort": "TUNED", "views": "ONLY", "goal": "SHARE", "share": 40, "recovery": 20})
    bpy.ops.svrgs.place_cameras()
    placed = part("operators.data.views_of_file").placed(splat)
    bpy.data.batch_remove([obj.data for obj in placed[10:]])
    run(watch)
    (job,) = watch.jobs.values()
    assert job.folder.result()["rig"]["given"] == 10


def test_cameras_that_cannot_be_placed_are_explained(splat, bridge):
    scene = bridge.scene_from_object(splat)
    scene.opacity_logits[:] = -12
    bridge.replace_gaussians(splat, scene)
    set_up({"effort": "TUNED"})
    with pytest.raises(RuntimeError, match="transparent"):
        bpy.ops.svrgs.place_cameras()
    assert "transparent" in said() and not bpy.data.cameras


# --- what may come next


def test_a_result_is_there_after_saving_and_opening_the_file(splat, bridge, watch, tmp_path):
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40})
    name = run(watch).name
    means = bridge.scene_from_object(bpy.data.objects[name]).means
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    result = bpy.data.objects[name]
    bpy.context.view_layer.objects.active = result
    assert "100 of 250 Gaussians" in said() and "against the original's own pictures" in said()
    bpy.ops.svrgs.apply()
    assert (bridge.scene_from_object(bpy.data.objects[name]).means == means).all()


def test_a_second_job_replaces_a_discarded_result_and_keeps_an_applied_one(splat, bridge, watch):
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40})
    run(watch)
    with pytest.raises(RuntimeError, match="Apply or discard the result first"):
        bpy.ops.svrgs.job_start()
    bpy.ops.svrgs.apply()
    splat.hide_set(False)
    bpy.context.view_layer.objects.active = splat
    set_up({"share": 20})
    watch.jobs.clear()
    second = run(watch)
    assert sorted(bridge.count(obj) for obj in bpy.data.objects if bridge.is_splat(obj)) == [50, 100, 250]
    assert bridge.count(second) == 50


def test_a_setting_without_effect_is_not_shown(splat):
    set_up({"effort": "TUNED", "goal": "SHARE"})
    assert "nested" not in drawn("prune")
    set_up({"goal": "LAMBDA", "nested": True})
    assert "nested" in drawn("prune")
    assert "nested" in part("operators.jobs.job").options_of(bpy.context, splat)
    set_up({"goal": "SHARE"})
    assert "nested" not in part("operators.jobs.job").options_of(bpy.context, splat)


def test_an_estimate_belongs_to_the_chosen_views(splat, shot):
    set_up({"effort": "TUNED", "goal": "SHARE", "share": 20, "recovery": 50})
    bpy.ops.svrgs.estimate()
    assert "would stay" in said()
    set_up({"views": "ALSO"})
    assert "would stay" not in said()


def test_much_use_of_the_disk_is_said_before_the_job(splat, monkeypatch):
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 40, "folder": "/tmp/many jobs"})
    assert "The job takes up to" not in said()
    monkeypatch.setattr(part("operators.jobs.prune_state"), "MUCH_BYTES", 0)
    quick = said()
    assert "The job takes up to 0.1 MB in 'many jobs', until its result is applied or discarded" in quick
    set_up({"effort": "TUNED"})
    assert "The job takes up to" in said() and said() != quick


def test_an_allowed_drop_has_an_estimate_and_a_result(splat, bridge, watch):
    set_up({"effort": "QUICK", "goal": "DROP", "drop": 1.0})
    bpy.ops.svrgs.estimate()
    assert "At most" in said()
    assert 10 < bridge.count(run(watch)) < 250
