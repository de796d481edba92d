"""Wipe in Viewport: what the two sides of a viewport show, and when there are two."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import part
from job_helpers import COUNT, drawn
from view_helpers import mark_removed, pixels


@pytest.fixture
def wipe():
    module = part("operators.view.viewport_wipe")
    bpy.context.scene.svrgs_view.property_unset("wipe")
    for name in ("original", "pruned"):
        setattr(bpy.context.scene.svrgs_view, name, None)
    yield module
    module.forget()


def sides(wipe) -> list:
    """Of a viewport that shows all visible splats."""
    bpy.context.view_layer.update()
    graph = bpy.context.evaluated_depsgraph_get()
    found = [part("operators.data.visible_splats").placed_splats(graph)]
    return wipe.sides(
        bpy.context.scene, wipe.shown([(obj, matrix) for pairs in found for obj, matrix in pairs])
    )


def counts(wipe) -> list[list[int]]:
    return [[part.scene.count for part in side.shown] for side in sides(wipe)]


def test_without_the_wipe_there_is_one_side(pruned, wipe):
    (side,) = sides(wipe)
    assert side.columns == (0, 1) and counts(wipe) == [[125]]


def test_the_original_is_left_of_the_line_and_the_pruned_splat_right_of_it(pruned, wipe, bridge):
    bpy.ops.svrgs.viewport_wipe()
    assert wipe.pair(bpy.context.scene) and counts(wipe) == [[COUNT], [125]]
    left, right = sides(wipe)
    assert (left.columns, right.columns) == ((0, 0.5), (0.5, 1))
    expected = [bridge.scene_from_object(obj).means for obj in pruned]
    for side, means in zip((left, right), expected, strict=True):
        assert {row.tobytes() for row in side.shown[0].scene.means} == {row.tobytes() for row in means}
        assert side.shown[0].matrix == pruned[1].matrix_world
    bpy.context.scene.svrgs_view.wipe = 0.25
    assert [side.columns for side in sides(wipe)] == [(0, 0.25), (0.25, 1)]
    bpy.ops.svrgs.viewport_wipe()
    assert wipe.pair(bpy.context.scene) is None and counts(wipe) == [[125]]


def test_the_right_side_is_what_apply_would_keep(pruned, wipe):
    bpy.ops.svrgs.viewport_wipe()
    for share, kept in ((20, 50), (60, 150), (50, 125)):
        before = [side.key for side in sides(wipe)]
        pruned[1].svrgs_share = share
        assert counts(wipe) == [[COUNT], [kept]]
        assert sides(wipe)[1].key != before[1], "or the viewport would go on to show the former picture"


def test_other_splats_are_on_both_sides(pruned, wipe, bridge, gaussians):
    bridge.object_from_scene("room", gaussians, bpy.context.scene.collection)
    bpy.ops.svrgs.viewport_wipe()
    assert sorted(map(sorted, counts(wipe))) == [[125, gaussians.count], [COUNT, gaussians.count]]


def test_marks_of_one_splat_are_a_pair_too(room, wipe, bridge):
    total = bridge.count(room)
    mark_removed(room, np.arange(total) % 3 == 0)
    bpy.ops.svrgs.viewport_wipe()
    assert counts(wipe) == [[total], [total - len(range(0, total, 3))]]


def test_it_does_not_depend_on_what_is_active(pruned, wipe, camera):
    bpy.ops.svrgs.viewport_wipe()
    bpy.context.view_layer.objects.active = camera
    assert counts(wipe) == [[COUNT], [125]]


def test_it_ends_with_its_splats_or_the_file(pruned, wipe):
    bpy.ops.svrgs.viewport_wipe()
    bpy.ops.svrgs.discard(what="RESULT")
    assert wipe.pair(bpy.context.scene) is None and counts(wipe) == [[COUNT]]
    with pytest.raises(RuntimeError, match="there is nothing to compare"):
        bpy.ops.svrgs.viewport_wipe()
    wipe._pair[:] = [1, 2]
    bpy.ops.wm.read_homefile(use_empty=True)
    assert not wipe._pair


def test_the_images_of_a_comparison_follow_when_it_ends(room, camera, wipe, bridge):
    """Writing them at each move of the line would make it slow."""
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    bpy.ops.svrgs.compare()
    before = pixels(bpy.data.images["SVR-GS Wipe"])
    bpy.ops.svrgs.viewport_wipe()
    bpy.context.scene.svrgs_view.wipe = 0.9
    assert (pixels(bpy.data.images["SVR-GS Wipe"]) == before).all()
    assert "svrgs.open_image" not in drawn("compare")
    bpy.ops.svrgs.viewport_wipe()
    assert (pixels(bpy.data.images["SVR-GS Wipe"]) != before).any() and "svrgs.open_image" in drawn("compare")
