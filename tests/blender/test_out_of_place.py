"""Splats, results and boxes that are hidden, moved aside, archived, linked, keyed or half deleted: what is
drawn, measured and written is what is seen, or a sentence says why not."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import COUNT, SHORT, drawn, follow, set_up
from mathutils import Matrix
from test_scenes_and_collections import activate, exclude, hide, imported, visible, with_cameras
from view_helpers import f12

SOURCE = DATA / "tiny/scene.ply"


def apart(ply, path) -> int:
    """Gaussians of a file that are not where one of the source is, or nearly."""
    means, source = ply.read_ply(path).means, ply.read_ply(SOURCE).means
    return int((np.linalg.norm(means[:, None] - source, axis=2).min(axis=1) > 0.05).sum())


def between() -> float:
    bpy.ops.svrgs.compare()
    return part("operators.view.compare").figures()["between"]


@pytest.fixture
def export(tmp_path, ply):
    """Exports the active splat; the path of the file."""

    def run(**choices):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.ply"), kind="ply", **choices)
        return tmp_path / "a.ply"

    return run


def test_an_original_that_is_archived_keeps_its_place(pruned, camera, ply, export, tmp_path):
    original, result = pruned
    archive = bpy.data.collections.new("Archive")
    bpy.context.scene.collection.children.link(archive)
    bpy.context.scene.collection.objects.unlink(original)
    archive.objects.link(original)
    exclude(archive)
    activate(result)
    before, names = between(), (original.name, result.name)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    original, result = (bpy.data.objects[name] for name in names)
    activate(result)
    assert between() == pytest.approx(before, abs=0.01)
    result.svrgs_share = 80
    assert apart(ply, export()) == 0
    bpy.ops.svrgs.apply()
    assert visible(result) == 200 and apart(ply, export()) == 0


def test_a_result_that_was_moved_aside_is_kept_together(pruned, ply, export):
    _, result = pruned
    result.svrgs_share = 80
    activate(result)
    sentence = "as in the original and, until Apply, in its place"
    assert sentence not in drawn("prune")
    result.location.x += 5
    bpy.context.view_layer.update()
    assert sentence in drawn("prune")
    bpy.ops.svrgs.apply()
    assert apart(ply, export(space="LOCAL")) == 0


def test_transforms_applied_to_a_result_are_those_of_what_comes_back(pruned, ply, export):
    _, result = pruned
    result.location.x += 5
    activate(result)
    bpy.ops.object.transform_apply()
    result.svrgs_share = 80
    bpy.context.view_layer.update()
    bpy.ops.svrgs.apply()
    result.location.x -= 5
    bpy.context.view_layer.update()
    assert apart(ply, export()) == 0


def test_points_that_were_deleted_from_a_result_do_not_come_back(pruned, bridge, ply, export):
    original, result = pruned
    hide(original, 60)
    left = np.arange(bridge.count(result)) % 4 > 0
    rows = part("operators.jobs.job_result").ROW
    kept = bridge.values(result, rows)[left]
    replaced = bridge.scene_from_object(result).select(left)
    further = bridge.further_values(result)
    bridge.replace_gaussians(result, replaced)
    part("operators.data.selection")._add_further(result, further, left)
    results = part("operators.jobs.job_result")
    assert results.shown_count(result) == left.sum()
    export_space = part("operators.io.export_space")
    assert not export_space.shows_original(result)
    result.svrgs_share = 55
    assert export_space.shows_original(result), "although fewer are left than the job has kept"
    result.svrgs_share = 80
    count = left.sum() + 75
    assert results.shown_count(result) == count
    activate(result)
    removed = bridge.values(original, "removed") == 0
    returned = removed & (bridge.values(original, results.SCORE) <= 0.5)
    hidden = (kept < 60).sum() + returned[:60].sum()
    assert ply.read_ply(export()).count == count - hidden
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == count and visible(result) == count - hidden


def test_gaussians_come_back_in_their_places_where_a_part_was_moved():
    place_of = part("svrgs_addon.prune.kept_share").place_of
    rng, moved = np.random.default_rng(0), np.array(Matrix.Translation((0, 0, 5)))
    before = rng.normal(size=(400, 3)).astype(np.float32)
    rows, after = np.arange(0, 400, 2), before[::2] + np.float32(0.001) * rng.normal(size=(200, 3))
    found = lambda means, some=rows: place_of(before, np.arange(400), means.astype(np.float32), some, moved)
    assert np.array_equal(found(after), np.eye(4))
    assert np.array_equal(found(after + (0, 0, 5)), moved)
    assert np.abs(found(after + (1, 0, 5))[:3, 3] - (1, 0, 5)).max() < 0.01
    half = after + np.where(np.arange(200)[:, None] < 120, (1, 0, 0), 0)
    assert np.array_equal(found(half), np.eye(4)), "by hand"
    broken = np.where(np.arange(200)[:, None] < 5, np.nan, after)
    assert np.array_equal(found(broken), np.eye(4))
    assert np.array_equal(found(after[:0], rows[:0]), moved)


def test_what_is_below_a_disabled_collection_stays_where_it_is(tmp_path):
    splat = with_cameras()
    above = bpy.data.collections.new("Above")
    bpy.context.scene.collection.children.link(above)
    cameras = part("operators.scene.contribution").chosen_cameras(bpy.context)
    collection = cameras[0].users_collection[0]
    bpy.context.scene.collection.children.unlink(collection)
    above.children.link(collection)
    place = part("operators.data.camera_object").camera_from_object
    before = {one.name: place(one, bpy.context.scene).viewmat for one in cameras}
    above.hide_viewport = True
    splat.hide_viewport = True
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    for name, viewmat in before.items():
        np.testing.assert_allclose(
            place(bpy.data.objects[name], bpy.context.scene).viewmat, viewmat, atol=1e-5
        )


def test_scripts_and_markers_keep_the_size_of_renders(stage, bridge):
    with_cameras()
    first, second = part("operators.scene.contribution").chosen_cameras(bpy.context)[:2]
    stage.render.resolution_x, stage.render.resolution_y = 640, 360
    bpy.context.view_layer.update()
    other = bpy.data.objects.new("other", bpy.data.cameras.new("other"))
    stage.collection.objects.link(other)
    stage.camera = other
    bpy.context.view_layer.update()
    assert stage.render.resolution_x == 640
    stage.camera = first
    bpy.context.view_layer.update()
    size = tuple(first.data["svrgs_size"])
    assert (stage.render.resolution_x, stage.render.resolution_y) == size, "of a photograph"
    stage.camera = other
    bpy.context.view_layer.update()
    stage.camera, stage.render.resolution_x = second, 800
    bpy.context.view_layer.update()
    assert stage.render.resolution_x == 800, "given together with the camera"
    for one in (first, second, first):
        stage.render.resolution_x, stage.camera = 800, one
        bpy.context.view_layer.update()
        assert stage.render.resolution_x == 800, "each time"
    stage.camera = other
    stage.render.resolution_x = 640
    bpy.context.view_layer.update()
    stage.camera = second
    stage.timeline_markers.new("cut", frame=1).camera = first
    stage.camera = first
    bpy.context.view_layer.update()
    assert stage.render.resolution_x == 640, "bound by a marker"
    stage.timeline_markers.clear()


def test_the_layer_has_the_camera_of_the_frame(stage, camera):
    other = camera.copy()
    stage.collection.objects.link(other)
    for frame, one in ((1, camera), (5, other)):
        stage.timeline_markers.new("cut", frame=frame).camera = one
    of_frame = part("operators.scene.splat_layer")._camera_of_frame
    found = []
    for frame in (1, 4, 5, 9):
        stage.frame_current = frame  # the scene's camera is not changed yet
        found.append(of_frame(stage))
    assert found == [camera, camera, other, other]
    stage.frame_current = -5
    assert of_frame(stage) == camera, "before the first one"
    camera.hide_render = True
    assert of_frame(stage) == other, "Blender skips those that are not rendered"
    stage.timeline_markers.clear()
    assert of_frame(stage) == stage.camera


def test_hidden_gaussians_are_not_in_what_scripts_prune(splat, bridge, ply):
    hide(splat, 100)
    bpy.ops.svrgs.prune(quick=True, target=0.5, overwrite=True)
    assert bridge.count(bpy.context.object) == 75


def test_a_result_with_merged_gaussians_says_what_is_seen_again(splat, watch):
    hide(splat, 100)
    set_up({"effort": "QUICK", "goal": "SHARE", "share": 50})
    bpy.ops.svrgs.job_start()
    results = part("operators.jobs.job_result")
    follow(watch, lambda: results.pruned_of(splat))
    assert "100 Gaussians that were hidden" in results.pruned_of(splat)[results.NOTES]


def test_edit_mode_is_left_before_an_export_without_hidden_gaussians(splat, ply, export):
    hide(splat, 100)
    assert ply.read_ply(export()).count == 150
    bpy.ops.object.mode_set(mode="EDIT")
    with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
        export()
    assert ply.read_ply(export(what="STORED")).count == COUNT
    bpy.ops.object.mode_set(mode="OBJECT")


def test_splats_with_one_crop_box_are_joined_and_those_with_two_are_not(splat, bridge):
    box, second = (bpy.data.objects.new(name, None) for name in ("box", "second"))
    for one in (box, second):
        one.empty_display_size = 0.8
        bpy.context.collection.objects.link(one)
    twin = splat.copy()
    twin.data, twin.location = splat.data.copy(), (0.3, 0, 0)
    bpy.context.collection.objects.link(twin)
    splat.svrgs_grade.crop, twin.svrgs_grade.crop = box, second
    second.location = (0.3, 0, 0)
    bpy.context.view_layer.update()
    activate(splat, twin)
    with pytest.raises(RuntimeError, match="use Apply Color first"):
        bpy.ops.svrgs.join_splats()
    twin.svrgs_grade.crop = box
    bpy.context.view_layer.update()
    seen = visible(splat) + visible(twin)
    assert bpy.ops.svrgs.join_splats() == {"FINISHED"} and visible(splat) == seen
    splat.svrgs_grade.keyframe_insert("exposure")
    third = imported()
    third.svrgs_grade.crop = box
    activate(splat, third)
    with pytest.raises(RuntimeError, match="use Apply Color first"):
        bpy.ops.svrgs.join_splats()


def test_cameras_are_not_joined_to_what_is_stretched_keyed_or_edited_nor_twice(bridge):
    splat = imported()
    splat.scale.z = 2
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="scaled unevenly"):
        bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    splat.scale.z = 1
    splat.keyframe_insert("location")
    for operator in (
        lambda: bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny")), bpy.ops.svrgs.apply_transforms,
    ):  # fmt: skip
        with pytest.raises(RuntimeError, match="keys or drivers move"):
            operator()
    assert bridge.root_of(splat) is None and not bpy.data.cameras
    splat.animation_data_clear()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    activate(splat)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert len(bpy.data.cameras) == 12, "in place of the former ones"
    own = bpy.data.objects["01.png"].copy()
    own.data = own.data.copy()
    bpy.context.collection.objects.link(own)
    name = own.name
    activate(splat)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert len(bpy.data.cameras) == 13 and name in bpy.data.objects, "the user's own stays"
    bpy.data.objects.remove(bpy.data.objects[name])
    activate(splat)
    splat.keyframe_insert("location")
    with pytest.raises(RuntimeError, match="keys or drivers move"):
        bpy.ops.svrgs.part_from_cameras()


def test_keys_of_nla_strips_are_found(splat):
    splat.svrgs_grade.exposure = 1
    splat.svrgs_grade.keyframe_insert("exposure")
    data = splat.animation_data
    strip = data.nla_tracks.new().strips.new("keys", 1, data.action)
    if hasattr(data, "action_slot"):
        strip.action_slot = data.action_slot
    data.action = None
    with pytest.raises(RuntimeError, match="remove their keys"):
        bpy.ops.svrgs.apply_grade()


def test_a_linked_splat_keeps_its_crop(splat, tmp_path):
    box = bpy.data.objects.new("box", None)
    box.empty_display_size = 0.5
    bpy.context.collection.objects.link(box)
    splat.svrgs_grade.crop = box
    bpy.context.view_layer.update()
    name, seen = splat.name, visible(splat)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "a.blend"), link=True) as (_, wanted):
        wanted.objects = [name]
    bpy.context.collection.objects.link(wanted.objects[0])
    bpy.context.view_layer.update()
    assert visible(wanted.objects[0]) == seen < COUNT


def test_a_splat_that_is_scaled_to_nothing_hides_no_other(stage, camera, room, bridge, gaussians, tmp_path):
    alone = f12(tmp_path / "a.png")
    other = bridge.object_from_scene("other", gaussians, stage.collection)
    other.scale = (0, 0, 0)
    assert np.array_equal(f12(tmp_path / "b.png"), alone)


def test_two_splats_far_from_the_origin_are_drawn_as_near_it(
    stage, camera, room, bridge, gaussians, tmp_path
):
    other = bridge.object_from_scene("other", gaussians, stage.collection)
    other.location = (0, -60, 0)  # behind the camera
    near = f12(tmp_path / "a.png")
    for one in (room, other, camera):
        one.location.x += 1e4
    # the numbers of Blender's matrices are of float32, too
    assert np.abs(f12(tmp_path / "b.png") - near).mean() < 0.004


def test_renders_say_that_splats_with_and_without_antialiasing_are_mixed(bridge, gaussians):
    placed, with_it = part("operators.data.visible_splats").placed, bridge.scene_from_object(imported())
    Scene = type(with_it)
    arrays = (getattr(with_it, name) for name in ("means", "log_scales", "quats", "opacity_logits", "sh"))
    other = Scene(*arrays, antialiased=not with_it.antialiased)
    assert placed([(with_it, Matrix()), (other, Matrix())]).mixed
    assert not placed([(with_it, Matrix()), (with_it, Matrix())]).mixed


def test_what_was_deleted_is_not_compared(pruned, camera, stage):
    original, result = pruned
    twin = result.copy()
    bpy.context.collection.objects.link(twin)
    settings = stage.svrgs_view
    settings.pruned, settings.compare_camera = twin, camera.copy()
    bpy.context.collection.objects.unlink(twin)
    activate(original)
    compare = part("operators.view.compare")
    assert compare.chosen_pair(bpy.context) == (original, result)
    assert compare.camera_of(bpy.context) == camera
    settings.pruned = settings.compare_camera = None


def test_new_objects_are_put_where_the_file_can_keep_them(tmp_path):
    linked = bpy.data.collections.new("Linked")
    bpy.context.scene.collection.children.link(linked)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "a.blend"), link=True) as (_, wanted):
        wanted.collections = ["Linked"]
    bpy.context.scene.collection.children.link(wanted.collections[0])
    layer = bpy.context.view_layer
    layer.active_layer_collection = layer.layer_collection.children["Linked"]
    assert bpy.context.collection.library is not None
    splat = imported()
    assert set(splat.users_collection) == {bpy.context.scene.collection}
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))


def test_a_format_that_the_name_contradicts_is_refused(splat, tmp_path):
    with pytest.raises(RuntimeError, match="not the name of a file in the format 'spz'"):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.ply"), kind="spz")
    assert not list(tmp_path.glob("a.*"))


def test_nothing_is_written_where_nothing_is_seen(splat, tmp_path):
    box = bpy.data.objects.new("box", None)
    box.location, box.empty_display_size = (1e3, 0, 0), 0.1
    bpy.context.collection.objects.link(box)
    splat.svrgs_grade.crop = box
    bpy.context.view_layer.update()
    for suffix in (".ply", ".spz"):
        with pytest.raises(RuntimeError, match="no Gaussian of 'scene"):
            bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"a{suffix}"))
    assert not list(tmp_path.glob("a.*"))


def test_edit_mode_selects_no_hidden_gaussian(splat, bridge):
    hide(splat, 100)
    if splat.type == "MESH":
        splat.data.vertices.foreach_set("select", np.ones(COUNT, bool))
    else:
        bridge.set_values(splat, ".selection", "BOOLEAN", np.ones(COUNT, bool))
    assert part("operators.data.selection").found_in_edit_mode(splat).sum() == 150


def test_cameras_of_another_capture_do_not_count_for_an_export(tmp_path, capfd):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = None
    splat = imported()
    splat.location = (0, 0, 500)
    bpy.context.view_layer.update()
    capfd.readouterr()
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.spz"))
    assert "see little of it" in capfd.readouterr().out
    splat.location = (0, 0, 0)
    bpy.context.view_layer.update()
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "b.spz"))
    assert "see little of it" not in capfd.readouterr().out


def test_every_splat_of_a_farm_job_on_photographs_has_some(tmp_path):
    one = with_cameras()
    bpy.context.view_layer.objects.active = None
    other = imported()
    activate(one, other)
    bpy.context.scene.svrgs_prune.data = ""
    set_up(SHORT | {"effort": "PHOTOGRAPHS"})
    with pytest.raises(RuntimeError, match=f"{other.name}: "):
        bpy.ops.svrgs.export_farm_job(directory=str(tmp_path / "job"))


def test_exports_that_fail_in_the_background_say_so(splat, tmp_path, monkeypatch):
    levels = part("operators.io.export_levels")
    SceneError = part("svrgs_addon.system.errors").SceneError

    def fail(*_):
        raise SceneError("no room")

    monkeypatch.setattr(levels, "_export", fail)
    with pytest.raises(RuntimeError, match="no room"):
        bpy.ops.svrgs.export_levels(directory=str(tmp_path))


def test_joined_splats_keep_the_attributes_that_all_have(splat, bridge, capfd):
    twin = splat.copy()
    twin.data = splat.data.copy()
    bpy.context.collection.objects.link(twin)
    bridge.set_values(splat, "one", "FLOAT2", np.full((COUNT, 2), 0.25, np.float32))
    for obj, value in ((splat, 1), (twin, 2)):
        bridge.set_values(obj, "both", "INT", np.full(COUNT, value, np.int32))
    activate(splat, twin)
    bpy.ops.svrgs.join_splats()
    assert np.array_equal(bridge.values(splat, "both"), np.repeat([1, 2], COUNT))
    assert "left out: one" in capfd.readouterr().out


@pytest.mark.parametrize("kind, width", [("FLOAT2", 2), ("BYTE_COLOR", 4), ("INT16_2D", 2), ("FLOAT4X4", 16)])
def test_what_is_left_keeps_attributes_of_all_kinds(splat, bridge, kind, width):
    if kind not in bpy.types.Attribute.bl_rna.properties["data_type"].enum_items:
        pytest.skip("this Blender has no such attributes")
    rng = np.random.default_rng(0)
    values = rng.integers(0, 2, (COUNT, width)).astype(bridge.KINDS[kind][2])
    bridge.set_values(splat, "more", kind, values)
    selection = part("operators.data.selection")
    selection.keep(splat, np.arange(COUNT) >= 100)
    np.testing.assert_array_equal(bridge.values(splat, "more"), values[100:])


def test_jobs_are_not_made_beside_a_file_that_was_not_saved(splat):
    bpy.ops.wm.read_homefile(use_empty=True)
    imported()
    bpy.context.scene.svrgs_prune.folder = "//jobs"
    set_up(SHORT | {"effort": "TUNED"})
    with pytest.raises(RuntimeError, match="has not been saved"):
        bpy.ops.svrgs.job_start()


def test_panels_draw_in_edit_mode(splat):
    hide(splat, 100)
    bpy.ops.object.mode_set(mode="EDIT")
    for name in ("prune", "select", "compare", "export"):
        drawn(name)
    assert part("operators.data.visible_splats").marked_count(splat) in (0, 100)
    assert part("operators.data.splat_size").size_in(splat, 10, "spz", 1.0, 3)
    bpy.ops.object.mode_set(mode="OBJECT")
