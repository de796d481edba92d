"""Colour settings of a splat: the same in the viewport's cache, renders, comparisons and exports; animated,
applied, and left out by pruning."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn, follow, set_up


@pytest.fixture
def splat():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    return bpy.context.object


def grade(obj, **values):
    for name, value in values.items():
        setattr(obj.svrgs_grade, name, value)
    bpy.context.view_layer.update()


def expected(bridge, obj, **values):
    module = part("svrgs_addon.scene.grade")
    return module.graded(bridge.scene_from_object(obj), module.Grade(**values))


def evaluated(obj):
    return obj.evaluated_get(bpy.context.evaluated_depsgraph_get())


VALUES = {"exposure": 0.5, "warmth": 0.25, "saturation": 0.5, "contrast": 1.25, "opacity": 0.5}


def test_what_is_seen_and_exported_is_graded_and_what_is_stored_is_not(splat, bridge, tmp_path):
    before, cache = bridge.scene_from_object(splat), part("operators.view.scene_cache")
    cache.read(evaluated(splat))
    grade(splat, **VALUES)
    wanted = expected(bridge, splat, **VALUES)
    visible = part("operators.data.visible_splats").visible_scene(evaluated(splat))
    np.testing.assert_array_equal(visible.sh, wanted.sh)
    rows = np.lexsort(wanted.means.T)
    cached = cache.read(evaluated(splat))
    np.testing.assert_array_equal(cached.sh[np.lexsort(cached.means.T)], wanted.sh[rows])
    read = part("svrgs_addon.files.registry").read_scene
    for what, scene in (("SEEN", wanted), ("STORED", before)):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"{what}.ply"), what=what)
        found = read(tmp_path / f"{what}.ply")
        np.testing.assert_array_equal(found.sh, scene.sh)
        np.testing.assert_array_equal(found.opacity_logits, scene.opacity_logits)
    np.testing.assert_array_equal(bridge.scene_from_object(splat).sh, before.sh)


def test_it_is_animated(splat, bridge):
    for frame, value in ((1, 0.0), (11, 2.0)):
        splat.svrgs_grade.exposure = value
        splat.svrgs_grade.keyframe_insert("exposure", frame=frame)
    visible = part("operators.data.visible_splats").visible_scene
    for frame in (1, 6, 11):
        bpy.context.scene.frame_set(frame)
        now = evaluated(splat).svrgs_grade.exposure
        assert (0 <= now <= 2) and (now in (0, 2) or frame == 6) and (0 < now < 2 or frame != 6)
        found = visible(evaluated(splat))
        np.testing.assert_array_equal(found.sh, expected(bridge, splat, exposure=now).sh)


def test_it_is_applied_to_the_gaussians(splat, bridge):
    with pytest.raises(RuntimeError, match="as they are stored"):
        bpy.ops.svrgs.apply_grade()
    grade(splat, **VALUES)
    wanted = expected(bridge, splat, **VALUES)
    assert "svrgs.apply_grade" in drawn("color")
    bpy.ops.svrgs.apply_grade()
    found = bridge.scene_from_object(splat)
    np.testing.assert_array_equal(found.sh, wanted.sh)
    np.testing.assert_allclose(found.opacity_logits, wanted.opacity_logits, atol=1e-5)
    assert splat.svrgs_grade.contrast == 1 and "svrgs.apply_grade" not in drawn("color")


def test_it_is_not_applied_to_gaussians_that_a_linked_duplicate_shares(splat, bridge):
    bpy.ops.object.duplicate(linked=True)
    grade(splat, **VALUES)
    bpy.context.view_layer.objects.active = splat
    before = bridge.scene_from_object(splat).sh
    with pytest.raises(RuntimeError, match="make them single-user first"):
        bpy.ops.svrgs.apply_grade()
    np.testing.assert_array_equal(bridge.scene_from_object(splat).sh, before)


def test_comparisons_and_results_keep_it_and_pruning_does_not_see_it(splat, bridge, watch, capfd):
    grade(splat, **VALUES)
    set_up({"data": "", "effort": "QUICK", "goal": "COUNT", "count": 100})
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: bpy.context.object != splat)
    result = bpy.context.object
    assert result.svrgs_grade.exposure == 0.5
    stored = bridge.scene_from_object(splat)
    colours = bridge.scene_from_object(result).sh[:, 0]
    low, high = stored.sh[:, 0].min(axis=0) - 0.2, stored.sh[:, 0].max(axis=0) + 0.2
    assert (colours >= low).all() and (colours <= high).all()
    compare = part("operators.view.compare")
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.ops.svrgs.compare()
    assert "with the settings of Color" in capfd.readouterr().out
    splats = compare.ComparedSplats(bpy.context)
    np.testing.assert_array_equal(splats.scenes[0].sh, expected(bridge, splat, **VALUES).sh)
    assert splats.scenes[1].count == 100 and not np.isin(splats.scenes[1].sh[:, 0], colours).all()


@pytest.fixture
def box(splat):
    """An empty around a part of the splat."""
    empty = bpy.data.objects.new("box", None)
    bpy.context.scene.collection.objects.link(empty)
    empty.empty_display_size = 0.5
    splat.svrgs_grade.crop = empty
    bpy.context.view_layer.update()
    return empty


def in_box(bridge, obj, box) -> np.ndarray:
    matrix = np.linalg.solve(np.array(box.matrix_world), np.array(obj.matrix_world))
    local = bridge.scene_from_object(obj).means @ matrix[:3, :3].T + matrix[:3, 3]
    return (np.abs(local) <= box.empty_display_size).all(axis=1)


def test_a_crop_box_hides_what_is_outside_of_it_wherever_it_is_moved(splat, bridge, box):
    cache, visible = part("operators.view.scene_cache"), part("operators.data.visible_splats")
    bridge.set_values(splat, "label", "FLOAT", np.arange(250, dtype=np.float32))
    for place in ((0, 0, 0), (0.3, 0, -0.2), (50, 0, 0)):
        box.location = place
        bpy.context.view_layer.update()
        kept = in_box(bridge, splat, box)
        assert 0 < kept.sum() < 250 or place[0] == 50
        rows = np.flatnonzero(kept)
        np.testing.assert_array_equal(visible.visible_rows(evaluated(splat)), rows)
        means = bridge.scene_from_object(splat).means
        np.testing.assert_array_equal(visible.visible_scene(evaluated(splat)).means, means[rows])
        assert cache.read(evaluated(splat)).count == len(rows)
        np.testing.assert_array_equal(np.sort(cache.read_values(evaluated(splat), "label")), rows)
    bpy.ops.svrgs.change_selection(how="INVERT")
    assert not bridge.values(splat, "svrgs:selected").any(), "what is hidden is not selected"


def test_a_crop_box_is_applied(splat, bridge, box):
    kept, means = in_box(bridge, splat, box), bridge.scene_from_object(splat).means
    bpy.ops.svrgs.apply_grade()
    np.testing.assert_array_equal(bridge.scene_from_object(splat).means, means[kept])
    assert splat.svrgs_grade.crop is None
    splat.svrgs_grade.crop = box
    box.location = (50, 0, 0)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="no Gaussian would be left"):
        bpy.ops.svrgs.apply_grade()


def test_a_picture_of_nothing_is_drawn(splat, box):
    box.location = (50, 0, 0)
    camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    bpy.context.scene.collection.objects.link(camera)
    bpy.context.scene.camera = camera
    bpy.context.scene.render.engine, bpy.context.scene.render.resolution_x = "SVRGS", 64
    bpy.context.scene.render.resolution_y = 48
    bpy.ops.render.render()
    box.location = (0, 0, 0)
    box.scale = (0, 1, 1)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="has no volume"):
        bpy.ops.svrgs.export_ply(filepath="never.ply")
    assert "has no volume" in drawn("color")


def test_it_is_saved_with_the_file_and_a_box_that_is_deleted_crops_nothing(splat, bridge, box, tmp_path):
    grade(splat, **VALUES)
    kept = int(in_box(bridge, splat, box).sum())
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    again = bpy.data.objects["scene"]
    assert again.svrgs_grade.exposure == 0.5 and again.svrgs_grade.crop.name == "box"
    shown = part("operators.data.visible_splats").visible_scene(evaluated(again))
    assert shown.count == kept
    bpy.data.objects.remove(bpy.data.objects["box"])
    bpy.context.view_layer.update()
    assert part("operators.data.visible_splats").visible_scene(evaluated(again)).count == 250


def test_an_override_of_a_linked_splat_has_a_grade_of_its_own(splat, tmp_path):
    collection = bpy.data.collections.new("asset")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(splat)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "asset.blend"))
    bpy.ops.wm.read_homefile(use_empty=True)
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True) as (_, wanted):
        wanted.collections = ["asset"]
    scene, layer = bpy.context.scene, bpy.context.view_layer
    scene.collection.children.link(wanted.collections[0])
    wanted.collections[0].override_hierarchy_create(scene, layer)
    (mine,) = (obj for obj in bpy.data.objects if obj.override_library)
    grade(mine, **VALUES)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "shot.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "shot.blend"))
    (again,) = (obj for obj in bpy.data.objects if obj.override_library)
    assert {name: getattr(again.svrgs_grade, name) for name in VALUES} == VALUES


def test_it_is_said_where_a_crop_box_that_moves_stands_still(splat, box, stage, camera, tmp_path, capfd):
    for frame, place in ((1, 0), (2, 50)):
        box.location.x = place
        box.keyframe_insert("location", frame=frame)
    sentence = "'box' is disabled in viewports or renders"
    stage.frame_end, stage.render.filepath = 2, str(tmp_path / "frame")
    for hidden in (False, True):
        box.hide_viewport = box.hide_render = hidden
        bpy.context.view_layer.update()
        assert (sentence in drawn("color")) == hidden
        bpy.ops.render.render(animation=True)
        assert (sentence in capfd.readouterr().out) == hidden


def test_nothing_is_said_of_a_crop_box_that_moves_with_an_instance(
    splat, box, stage, camera, tmp_path, capfd
):
    for frame, place in ((1, 0), (2, 50)):
        box.location.x = place
        box.keyframe_insert("location", frame=frame)
    asset, instance = bpy.data.collections.new("asset"), bpy.data.objects.new("instance", None)
    for obj in (splat, box):
        obj.users_collection[0].objects.unlink(obj)
        asset.objects.link(obj)
    instance.instance_type, instance.instance_collection = "COLLECTION", asset
    stage.collection.objects.link(instance)
    stage.frame_end, stage.render.filepath = 2, str(tmp_path / "frame")
    bpy.ops.render.render(animation=True)
    assert "stands still" not in capfd.readouterr().out
    assert len({(tmp_path / f"frame000{frame}.png").read_bytes() for frame in (1, 2)}) == 2, "it moves"


@pytest.mark.parametrize("kind", ["LATTICE", "FONT"])
def test_a_crop_box_is_the_box_that_is_seen(splat, kind):
    """Of these, Blender knows it of the evaluated object alone, or of the other alone."""
    bpy.ops.object.add(type=kind, location=(0, 0, 0))
    obj = bpy.context.object
    if kind == "LATTICE":
        obj.data.points_w, wanted = 2, (0.5, 0.5, 0.5)
    else:
        obj.data.extrude, wanted = 0.4, None
    bpy.context.view_layer.update()
    matrix_of = part("operators.data.world_matrix").volume_matrix
    found = matrix_of(obj)
    np.testing.assert_array_equal(found, matrix_of(evaluated(obj)))
    assert wanted is None or tuple(np.diag(found)[:3]) == wanted
    assert abs(found[2, 2] - (0.5 if wanted else 0.4)) < 1e-6
