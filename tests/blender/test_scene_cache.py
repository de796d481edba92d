"""Gaussians kept for drawing: read anew when they change, and gone with their splat."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import part
from mathutils import Matrix
from view_helpers import add_geometry_nodes, view_of

pytestmark = pytest.mark.usefixtures("stage")


def seen_number(obj) -> int:
    """Of what is kept of the splat for drawing."""
    return part("operators.view.scene_cache").number(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def test_gaussians_that_change_by_frame_are_read_anew_and_others_are_not(
    stage, bridge, gaussians, room, camera
):
    """Geometry nodes that move the points up with time."""
    still = bridge.object_from_scene("still", gaussians, stage.collection)

    def rising(group, geometry):
        time, offset = map(group.nodes.new, ("GeometryNodeInputSceneTime", "ShaderNodeCombineXYZ"))
        move = group.nodes.new("GeometryNodeSetPosition")
        group.links.new(geometry, move.inputs[0])
        group.links.new(time.outputs["Frame"], offset.inputs[2])
        group.links.new(offset.outputs[0], move.inputs["Offset"])
        return move.outputs[0]

    add_geometry_nodes(room, rising)
    stage.frame_set(1)
    before = seen_number(room), seen_number(still)
    stage.frame_set(3)
    shown = part("operators.view.scene_cache").read(room.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    np.testing.assert_allclose(shown.means[:, 2].mean(), gaussians.means[:, 2].mean() + 3, atol=1e-4)
    assert seen_number(room) != before[0] and seen_number(still) == before[1]


def test_nothing_is_kept_of_a_splat_that_is_gone(stage, bridge, gaussians, room, camera):
    cache = part("operators.view.scene_cache")
    other = bridge.object_from_scene("other", gaussians, stage.collection)
    bpy.context.view_layer.update()
    cache._entries.clear()
    seen_number(room), seen_number(other)
    bpy.data.objects.remove(other)
    bpy.context.view_layer.update()
    assert {uid for uid, *_ in cache._entries} == {room.session_uid}


def test_a_selection_is_read_and_the_gaussians_are_not_read_anew(stage, gaussians, room):
    """But what was changed before it is, in the same breath."""
    cache, change = part("operators.view.scene_cache"), part("operators.data.selection").change
    evaluated = lambda: room.evaluated_get(bpy.context.evaluated_depsgraph_get())
    before, mask = cache.read(evaluated()), np.zeros(gaussians.count, bool)
    for row in (3, 5):
        mask[row], number = True, seen_number(room)
        change(room, mask, "SET")
        assert seen_number(room) != number, "a viewport draws it"
        order = np.array(
            [np.flatnonzero((before.means == mean).all(axis=1))[0] for mean in gaussians.means[mask]]
        )
        values = cache.read_values(evaluated(), "svrgs:selected")
        assert sorted(np.flatnonzero(values)) == sorted(order)
        if room.type == "POINTCLOUD":
            assert cache.read(evaluated()) is before
    ones = np.ones(gaussians.count, np.float32)
    part("operators.data.splat_object").set_values(room, "of a script", "FLOAT", ones)
    change(room, ~mask, "SET")
    assert cache.read(evaluated()) is not before


def test_a_splat_that_moves_is_not_measured_anew(gaussians, camera, stage, monkeypatch):
    """For the unit of its cameras: that would take longer than a picture of a moving view may."""
    module, measured = part("operators.data.visible_splats"), []
    monkeypatch.setattr(module, "unit_around", lambda scene: measured.append(scene) or 1.0)
    view = view_of(camera, stage)
    for place in range(3):
        module.placed([(gaussians, Matrix.Translation((place, 0, 0)))]).seen_by(view)
    assert len(measured) == 1
