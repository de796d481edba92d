"""Selecting Gaussians in Blender: criteria, how they combine, Edit Mode, deletion, undo."""

from __future__ import annotations

import re

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn
from mathutils import Matrix

SELECTED = "svrgs:selected"


@pytest.fixture
def splat():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    return bpy.context.object


def selected(obj) -> np.ndarray:
    return part("operators.data.splat_object").values(obj, SELECTED).astype(bool)


def world(bridge, obj) -> np.ndarray:
    """(N, 3) centres in Blender's world."""
    matrix = np.array(obj.matrix_world)
    return bridge.scene_from_object(obj).means @ matrix[:3, :3].T + matrix[:3, 3]


def opacities(bridge, obj) -> np.ndarray:
    return 1 / (1 + np.exp(-bridge.scene_from_object(obj).opacity_logits.astype(np.float64)))


def test_opacity_and_how_selections_combine(splat, bridge):
    values = opacities(bridge, splat)
    low, high = values <= 0.5, values >= 0.3
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    assert 0 < selected(splat).sum() < 250 and (selected(splat) == low).all()
    for mode, expected in (("EXTEND", low | high), ("INTERSECT", high), ("SUBTRACT", high & ~high)):
        bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0.3, opacity_high=1, mode=mode)
        assert (selected(splat) == expected).all(), mode
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5, invert=True)
    assert (selected(splat) == ~low).all()


@pytest.mark.parametrize("criterion", ["BOX", "SPHERE"])
def test_an_object_bounds_a_box_or_a_sphere_wherever_both_stand(splat, bridge, criterion):
    splat.location, splat.rotation_euler.z, splat.scale = (3, -2, 1), 0.7, (2, 2, 2)
    bpy.context.view_layer.update()
    centres = world(bridge, splat)
    bpy.ops.object.empty_add(type="CUBE", location=np.median(centres, axis=0))
    empty = bpy.context.object
    empty.empty_display_size, empty.rotation_euler.x = 0.4 * float(centres.std()), 0.5
    bpy.context.view_layer.update()
    bpy.context.view_layer.objects.active = splat
    bpy.ops.svrgs.select_gaussians(criterion=criterion, volume=empty.name)
    local = (
        (centres - np.array(empty.location))
        @ np.array(empty.matrix_world.to_3x3())
        / empty.empty_display_size
    )
    inside = (np.abs(local) <= 1).all(axis=1) if criterion == "BOX" else (local**2).sum(axis=1) <= 1
    assert 10 < inside.sum() < 240 and (selected(splat) == inside).mean() > 0.99


def test_without_an_object_a_box_says_what_to_do(splat):
    with pytest.raises(RuntimeError, match="choose the object that bounds the box or sphere"):
        bpy.ops.svrgs.select_gaussians(criterion="BOX")


def test_sizes_are_lengths_in_blender(splat, bridge):
    splat.scale = (3, 3, 3)
    bpy.context.view_layer.update()
    largest = 3 * np.exp(bridge.scene_from_object(splat).log_scales.max(axis=1))
    middle = float(np.median(largest))
    bpy.ops.svrgs.select_gaussians(criterion="SIZE", size_low=middle)
    assert (selected(splat) == (largest >= middle)).mean() > 0.98 and 100 < selected(splat).sum() < 150


def test_what_cameras_see_needs_cameras(splat):
    for criterion in ("CONTRIBUTION", "REMOVAL_ERROR", "SEEN"):
        with pytest.raises(RuntimeError, match="there is no such camera"):
            bpy.ops.svrgs.select_gaussians(criterion=criterion)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    for criterion in ("CONTRIBUTION", "REMOVAL_ERROR"):
        bpy.ops.svrgs.select_gaussians(criterion=criterion, share=20)
        assert selected(splat).sum() == 50
    bpy.ops.svrgs.select_gaussians(criterion="SEEN")
    seen = selected(splat)
    assert 0 < seen.sum() < 250, "tiny holds Gaussians that no photograph shows"
    bpy.ops.svrgs.select_gaussians(criterion="FLOATERS")
    assert selected(splat).sum() < 100


def test_cameras_that_see_few_gaussians_are_told(splat, capfd):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    bpy.ops.svrgs.select_gaussians(criterion="CONTRIBUTION", share=20)
    assert "come first" not in capfd.readouterr().out
    camera = bpy.context.scene.camera
    camera.matrix_world = camera.matrix_world @ Matrix.Rotation(0.7, 4, "Y")  # turned to the side
    bpy.context.view_layer.update()
    bpy.ops.svrgs.select_gaussians(criterion="CONTRIBUTION", share=20, cameras="ACTIVE")
    said = re.search(r"Selected 50 of 250 Gaussians; 1 views see only (\d+)% of", capfd.readouterr().out)
    assert int(said[1]) < 50
    bpy.ops.svrgs.select_gaussians(criterion="SEEN", cameras="ACTIVE")
    assert "come first" not in capfd.readouterr().out


def test_selected_gaussians_are_deleted_or_kept_alone(splat, bridge):
    splat.data.attributes.new("mine", "FLOAT", "POINT").data.foreach_set(
        "value", np.arange(250, dtype=np.float32)
    )
    low = opacities(bridge, splat) <= 0.5
    before = bridge.scene_from_object(splat)
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    bpy.ops.svrgs.delete_gaussians(what="SELECTED")
    after = bridge.scene_from_object(splat)
    assert (after.means == before.means[~low]).all() and (after.sh == before.sh[~low]).all()
    assert (bridge.values(splat, "mine") == np.flatnonzero(~low)).all()
    assert SELECTED not in splat.data.attributes
    with pytest.raises(RuntimeError, match="Select Gaussians first"):
        bpy.ops.svrgs.delete_gaussians()
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0.8, opacity_high=1)
    kept = int(selected(splat).sum())
    bpy.ops.svrgs.delete_gaussians(what="OTHERS")
    assert bridge.count(splat) == kept > 0
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=1)
    with pytest.raises(RuntimeError, match="no Gaussian would be left"):
        bpy.ops.svrgs.delete_gaussians(what="SELECTED")
    assert bridge.count(splat) == kept


def test_blenders_edit_mode_has_the_same_selection(splat, bridge):
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    mask = selected(splat)
    assert (part("operators.data.selection").found_in_edit_mode(splat) == mask).all()
    bpy.ops.svrgs.clear_selection()
    assert SELECTED not in splat.data.attributes
    assert not part("operators.data.selection").found_in_edit_mode(splat).any()


def test_the_panel_counts_and_the_viewport_shows_it(splat):
    looking = bpy.context.scene.svrgs_view
    assert "svrgs.select_gaussians" in drawn("select") and "svrgs.delete_gaussians" not in drawn("select")
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    count = int(selected(splat).sum())
    assert part("operators.data.selection").selected_count(bpy.context.object) == count
    assert f"{count:,} Gaussians selected" in drawn("select") and looking.overlay_shown == SELECTED
    bpy.ops.svrgs.clear_selection()
    assert part("operators.data.selection").selected_count(bpy.context.object) == 0
    assert looking.overlay_shown == "COLOR"


def test_a_result_that_is_not_applied_is_not_cut(splat, bridge):
    results = part("operators.jobs.job_result")
    copy = bridge.copy_with(splat, "pruned", bridge.scene_from_object(splat).select(np.arange(100)))
    results.join(splat, copy)
    copy[results.KEPT], copy[results.MERGED] = 100, True
    bpy.context.view_layer.objects.active = splat
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    with pytest.raises(RuntimeError, match="Apply or discard the pruning result"):
        bpy.ops.svrgs.delete_gaussians()


def test_a_colour_is_selected_with_a_tolerance(splat, bridge):
    colours = 0.5 + 0.28209479 * bridge.scene_from_object(splat).sh[:, 0]
    bpy.ops.svrgs.select_gaussians(criterion="COLOR", color=colours[3], tolerance=0.2)
    expected = np.linalg.norm(colours - colours[3], axis=1) <= 0.2
    assert 0 < expected.sum() < len(expected)
    np.testing.assert_array_equal(selected(splat), expected)
    splat.svrgs_grade.saturation = 0
    bpy.ops.svrgs.select_gaussians(criterion="COLOR", color=colours[3], tolerance=0.2)
    assert (selected(splat) != expected).any(), "colours are compared as they are seen"


def test_a_selection_is_inverted_grows_and_shrinks(splat, bridge):
    means = bridge.scene_from_object(splat).means.astype(np.float64)
    distances = np.linalg.norm(means[:, None] - means, axis=2)
    np.fill_diagonal(distances, np.inf)
    near = np.argsort(distances, axis=1)[:, :8]
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0.9, opacity_high=1)
    before = selected(splat)
    bpy.ops.svrgs.change_selection(how="INVERT")
    np.testing.assert_array_equal(selected(splat), ~before)
    bpy.ops.svrgs.change_selection(how="SHRINK")
    inner = ~before & (~before)[near].all(axis=1)
    np.testing.assert_array_equal(selected(splat), inner)
    bpy.ops.svrgs.change_selection(how="GROW")
    outer = inner.copy()
    outer[near[inner].ravel()] = True
    np.testing.assert_array_equal(selected(splat), outer)
    assert inner.sum() < outer.sum() < 250


def test_selected_gaussians_become_a_splat_of_their_own(splat, bridge):
    whole = bridge.scene_from_object(splat)
    bridge.set_values(splat, "label", "FLOAT", np.arange(whole.count, dtype=np.float32))
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_high=0.5)
    mask = selected(splat)
    bpy.ops.svrgs.separate_gaussians()
    (other,) = (obj for obj in bpy.data.objects if bridge.is_splat(obj) and obj != splat)
    for obj, rows in ((other, mask), (splat, ~mask)):
        np.testing.assert_array_equal(bridge.scene_from_object(obj).means, whole.means[rows])
        np.testing.assert_array_equal(bridge.values(obj, "label"), np.flatnonzero(rows))
        assert obj.matrix_world == splat.matrix_world and "svrgs:selected" not in obj.data.attributes
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_high=1)
    with pytest.raises(RuntimeError, match="no Gaussian would be left"):
        bpy.ops.svrgs.separate_gaussians()


def test_hidden_gaussians_are_in_no_view_and_no_file_until_they_are_shown(splat, bridge, tmp_path):
    low = opacities(bridge, splat) <= 0.5
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=0.5)
    bpy.ops.svrgs.hide_gaussians()
    shown = part("operators.data.visible_splats").visible_scene
    graph = bpy.context.evaluated_depsgraph_get()
    assert shown(splat.evaluated_get(graph)).count == (~low).sum() and bridge.count(splat) == 250
    assert f"{low.sum():,} Gaussians are hidden" in drawn("select")
    assert f"{low.sum():,} hidden Gaussians stay out of the file" in drawn("export")
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "seen.ply"))
    assert part("svrgs_addon.files.registry").read_scene(tmp_path / "seen.ply").count == (~low).sum()
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0, opacity_high=1)
    assert (selected(splat) == ~low).all(), "criteria select what is seen"
    with pytest.raises(RuntimeError, match="no Gaussian would be left"):
        bpy.ops.svrgs.hide_gaussians()
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0.9, opacity_high=1)
    more = int(selected(splat).sum())
    bpy.ops.svrgs.hide_gaussians()
    assert part("operators.data.selection").hidden_count(splat) == low.sum() + more
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    splat = bpy.data.objects["scene"]
    bpy.context.view_layer.objects.active = splat
    assert f"{low.sum() + more:,} Gaussians are hidden" in drawn("select")
    bpy.ops.svrgs.select_gaussians(criterion="OPACITY", opacity_low=0.6, opacity_high=1)
    kept = int(selected(splat).sum())
    bpy.ops.svrgs.delete_gaussians(what="OTHERS")
    assert bridge.count(splat) == kept + low.sum() + more, "hidden ones are not deleted with the others"
    bpy.ops.svrgs.show_gaussians()
    graph = bpy.context.evaluated_depsgraph_get()
    assert shown(splat.evaluated_get(graph)).count == bridge.count(splat)
    assert "are hidden" not in drawn("select")
