"""View layers, excluded and foreign collections, several splats and datasets in one file: each splat keeps
what is its own."""

from __future__ import annotations

import json
import shutil
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import COUNT, SHORT, drawn, follow, set_up
from view_helpers import f12


def imported(path=DATA / "tiny/scene.ply") -> bpy.types.Object:
    bpy.ops.svrgs.import_ply(filepath=str(path))
    return bpy.context.object


def with_cameras(folder=DATA / "tiny") -> bpy.types.Object:
    """A splat that is joined to the cameras of a dataset."""
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    splat = imported(folder / "scene.ply")
    assert part("operators.data.splat_object").root_of(splat) is not None
    return splat


def exclude(collection: bpy.types.Collection, layer=None):
    layer = layer or bpy.context.view_layer
    layer.layer_collection.children[collection.name].exclude = True


def activate(obj, *others):
    for one in bpy.context.view_layer.objects:
        one.select_set(one in (obj, *others))
    bpy.context.view_layer.objects.active = obj


def hide(obj, count: int):
    part("operators.data.selection").carry_hidden(obj, [np.arange(COUNT) < count])


def visible(obj) -> int:
    return part("operators.data.visible_splats").visible_scene(obj).count


def test_each_view_layer_has_its_own_picture(stage, camera, room, tmp_path):
    near, second = bpy.data.collections.new("Near"), stage.view_layers.new("Second")
    stage.collection.children.link(near)
    near.objects.link(room)
    stage.collection.objects.unlink(room)
    twin = room.copy()
    twin.location = (3, 0, 0)
    stage.collection.objects.link(twin)
    exclude(near, second)
    bpy.context.view_layer.update()
    alone = {}
    for layer in stage.view_layers:
        for one in stage.view_layers:
            one.use = one == layer
        alone[layer.name] = f12(tmp_path / "alone.png")
    for one in stage.view_layers:
        one.use = True
    both = f12(tmp_path / "both.png")
    stage.view_layers.remove(second)
    assert np.abs(alone["Second"] - alone[stage.view_layers[0].name]).max() > 0.1
    assert np.abs(both - alone[stage.view_layers[0].name]).max() == 0, "without nodes, the first one is saved"


def test_stereo_is_refused(stage, camera, room, tmp_path):
    stage.render.use_multiview = True
    with pytest.raises(RuntimeError, match="one camera at a time"):
        f12(tmp_path / "a.png")
    stage.render.use_multiview = False


def test_borders_are_counted_as_blender_does():
    """In float32, with any size."""
    borders = part("operators.data.camera_object").borders
    assert borders(np.float32(0.1), np.float32(0.7), 1920) == (192, 1344)
    assert borders(np.float32(0.3), np.float32(0.7), 10) == (3, 7)


def test_a_farm_job_has_the_dataset_of_each_splat(tmp_path, bridge):
    shutil.copytree(DATA / "tiny", tmp_path / "other")
    one, other = with_cameras(), with_cameras(tmp_path / "other")
    one.name, other.name = "one", "two"
    activate(one, other)
    bpy.context.scene.svrgs_prune.data = ""
    set_up(SHORT | {"effort": "PHOTOGRAPHS"})
    bpy.ops.svrgs.export_farm_job(directory=str(tmp_path / "job"))
    tasks = json.loads((tmp_path / "job/job.json").read_text())["tasks"]
    found = {task["name"]: task["options"]["data"].rpartition("/")[2] for task in tasks}
    assert found == {"one": (DATA / "tiny").resolve().name, "two": "other"}


def test_placed_cameras_and_those_of_another_dataset_are_no_photographs_of_a_splat(tmp_path):
    shutil.copytree(DATA / "tiny", tmp_path / "other")
    one, _ = with_cameras(), with_cameras(tmp_path / "other")
    activate(one)
    root = part("operators.data.splat_object").root_of(one)
    chosen = part("operators.scene.contribution").chosen_cameras
    photographs = part("operators.scene.photographs").of(root)
    assert len(photographs) == len(chosen(bpy.context)) == 12
    bpy.ops.svrgs.place_cameras()
    assert len(part("operators.data.views_of_file").placed(one)) >= 8
    assert part("operators.scene.photographs").of(root) == photographs == chosen(bpy.context)
    assert len(part("operators.io.export_space").camera_objects(bpy.context, one)) == 12


def test_cameras_and_crop_boxes_of_an_excluded_collection_stay_where_they_are(tmp_path, bridge):
    splat = with_cameras()
    name, cameras = splat.name, part("operators.scene.contribution").chosen_cameras(bpy.context)
    collection = cameras[0].users_collection[0]
    box = bpy.data.objects.new("box", None)
    box.location, box.empty_display_size = (0.3, 0.2, 0.1), 0.8
    collection.objects.link(box)
    splat.svrgs_grade.crop = box
    place = part("operators.data.camera_object").camera_from_object
    bpy.context.view_layer.update()
    before = {one.name: place(one, bpy.context.scene).viewmat for one in cameras}, visible(splat)
    exclude(collection)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    for camera_name, viewmat in before[0].items():
        found = place(bpy.data.objects[camera_name], bpy.context.scene).viewmat
        np.testing.assert_allclose(found, viewmat, atol=1e-5)
    assert visible(bpy.data.objects[name]) == before[1] < COUNT
    bpy.data.objects["box"].users_collection[0].objects.unlink(bpy.data.objects["box"])
    assert visible(bpy.data.objects[name]) == COUNT, "a box that was deleted crops nothing"


def test_a_result_appears_where_its_splat_is_seen(splat, bridge):
    elsewhere = bpy.data.collections.new("Elsewhere")
    bpy.context.collection.objects.unlink(splat)
    elsewhere.objects.link(splat)
    bpy.context.scene.collection.objects.link(splat)
    activate(splat)
    set_up({"effort": "QUICK"})
    bpy.ops.svrgs.prune(quick=True, target=0.5, overwrite=True)
    (result,) = (obj for obj in bpy.context.scene.objects if obj != splat and bridge.is_splat(obj))
    assert set(result.users_collection) == set(splat.users_collection) and not result.hide_get()
    activate(splat)
    splat.hide_set(False)
    bpy.ops.svrgs.place_cameras()
    assert any(obj.type == "CAMERA" for obj in bpy.context.scene.objects)


def test_scripts_prune_twice_and_quickly_also_where_there_are_cameras(bridge):
    splat = with_cameras()
    bpy.context.scene.svrgs_prune.data = ""
    for share in (0.5, 0.25):
        activate(splat)
        assert bpy.ops.svrgs.prune(quick=True, target=share, overwrite=True) == {"FINISHED"}
    shown = [obj for obj in bpy.context.scene.objects if bridge.is_splat(obj) and not obj.hide_get()]
    assert [bridge.count(obj) for obj in shown] == [COUNT // 4], "one result is seen"


def test_hidden_gaussians_stay_hidden_in_joined_splats_and_in_results(pruned, bridge):
    original, result = pruned
    assert visible(result) == 125
    bpy.ops.svrgs.discard(what="RESULT")
    hide(original, 60)
    twin = original.copy()
    twin.data = original.data.copy()
    bpy.context.collection.objects.link(twin)
    part("operators.data.selection").show_all(twin)
    twin.svrgs_grade.exposure = 1.0
    activate(original, twin)
    with pytest.raises(RuntimeError, match="use Apply Color first"):
        bpy.ops.svrgs.join_splats()
    twin.svrgs_grade.exposure = 0.0
    assert bpy.ops.svrgs.join_splats() == {"FINISHED"}
    assert (bridge.count(original), visible(original)) == (2 * COUNT, 2 * COUNT - 60)


def test_a_result_hides_what_was_hidden_and_is_exported_as_it_is_seen(splat, watch, bridge, ply, tmp_path):
    hide(splat, 60)
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    results = part("operators.jobs.job_result")
    follow(watch, lambda: results.pruned_of(splat))
    result = results.pruned_of(splat)
    kept = (bridge.values(splat, "removed") == 0)[:60].sum()
    assert visible(result) == 125 - kept
    compared = part("operators.view.compare").ComparedSplats(bpy.context).scenes[0]
    assert compared.count == COUNT - 60
    result.svrgs_share = 80
    activate(result)
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.ply"), kind="ply")
    dialog = part("operators.io.export_ply").SVRGS_OT_export_ply
    assert dialog.count(SimpleNamespace(what="SEEN"), result) == visible(splat) < 200
    assert ply.read_ply(tmp_path / "a.ply").count == visible(splat) and "200 Gaussians" in drawn("export")
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 200 and visible(result) == ply.read_ply(tmp_path / "a.ply").count


def test_colours_that_are_animated_are_not_applied(splat):
    splat.svrgs_grade.exposure = 1.0
    splat.svrgs_grade.keyframe_insert("exposure")
    with pytest.raises(RuntimeError, match="remove their keys"):
        bpy.ops.svrgs.apply_grade()
    splat.animation_data_clear()
    assert bpy.ops.svrgs.apply_grade() == {"FINISHED"}


def test_the_other_selected_object_is_the_volume_each_time(splat, bridge):
    counts = []
    for x in (-1.0, 1.0):
        empty = bpy.data.objects.new("empty", None)
        empty.location = (x, 0, 0)
        bpy.context.collection.objects.link(empty)
        bpy.context.view_layer.update()
        activate(splat, empty)
        bpy.ops.svrgs.select_gaussians("INVOKE_DEFAULT", criterion="BOX")
        counts.append(bridge.values(splat, "svrgs:selected").copy())
        bpy.data.objects.remove(empty)
    assert counts[0].any() and counts[1].any() and not (counts[0] & counts[1]).any()


def test_views_of_frames_leave_what_was_moved_by_hand(splat):
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    for frame, x in ((1, -5.0), (20, 5.0)):
        camera.location = (x, -5, 0)
        camera.keyframe_insert("location", frame=frame)
    bpy.context.scene.frame_set(5, subframe=0.5)
    camera.location = (0, -4, 1)
    bpy.context.view_layer.update()
    views = part("operators.data.views_of_file").views(bpy.context, splat)
    assert tuple(camera.location) == (0, -4, 1)
    assert (bpy.context.scene.frame_current, bpy.context.scene.frame_subframe) == (5, 0.5)
    assert len(views) > 2
