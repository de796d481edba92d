"""A splat that is moved, transformed or given modifiers around a pruning job: the result lies where the
original lies."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import SHORT, follow, set_up
from mathutils import Euler, Matrix
from test_splat_transforms import crop_nodes
from view_helpers import add_geometry_nodes

MOVED = Matrix.LocRotScale((2, 1, 0.5), Euler((1.0, 2.0, 3.0)), (1.7, 1.7, 1.7))


def finish(watch, results, splat) -> bpy.types.Object:
    follow(watch, lambda: results.pruned_of(splat))
    return results.pruned_of(splat)


def nearest_distances(bridge, pruned, original) -> np.ndarray:
    """From each Gaussian of the result to the one of the original that it was, in Blender's world."""
    rows = bridge.values(pruned, "svrgs:row")
    matrices = [np.array(obj.matrix_world) for obj in (pruned, original)]
    positions = [
        bridge.values(obj, "position") @ M[:3, :3].T + M[:3, 3]
        for obj, M in zip((pruned, original), matrices, strict=True)
    ]
    return np.linalg.norm(positions[0] - positions[1][rows], axis=1)


def test_transforms_applied_meanwhile_reach_the_result(splat, watch, results, bridge):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    splat.matrix_world = MOVED @ splat.matrix_world
    bpy.context.view_layer.update()
    bpy.ops.object.transform_apply()
    pruned = finish(watch, results, splat)
    bpy.context.view_layer.update()
    moved_by_recovery = nearest_distances(bridge, pruned, splat)
    assert np.median(moved_by_recovery) < 0.05 and bridge.count_moved(pruned) == 0
    ratio = (
        bridge.scene_from_object(pruned).log_scales
        - bridge.scene_from_object(splat).log_scales[bridge.values(pruned, "svrgs:row")]
    )
    assert abs(np.median(ratio)) < 0.2  # shapes have the applied scale too, log(1.7) = 0.53


def test_points_moved_one_by_one_meanwhile_are_refused(splat, watch, results, bridge):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    positions = bridge.values(splat, "position")
    positions[::2] += np.random.default_rng(0).normal(size=positions[::2].shape).astype(np.float32)
    splat.data.attributes["position"].data.foreach_set("vector", positions.reshape(-1))
    follow(watch, lambda: job.state == "done")
    assert results.pruned_of(splat) is None
    with pytest.raises(RuntimeError, match="were moved since the job began: undo"):
        bpy.ops.svrgs.job_load()


def test_the_result_has_the_modifiers_of_its_original(splat, watch, results):
    add_geometry_nodes(splat, crop_nodes)
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    pruned = finish(watch, results, splat)
    assert [m.name for m in pruned.modifiers] == ["test", "SVR-GS Removed"]
    assert pruned.modifiers["test"].node_group == splat.modifiers["test"].node_group


def test_gaussians_brought_back_lie_where_the_original_shows_them(pruned, bridge):
    """The original was transformed after the job: Keep takes some of its Gaussians into the result."""
    original, result = pruned
    original.hide_set(False)
    bpy.context.view_layer.update()
    before = bridge.scene_from_object(original)
    bpy.ops.object.select_all(action="DESELECT")
    original.select_set(True)
    bpy.context.view_layer.objects.active = original
    bpy.ops.object.transform_apply()
    bpy.context.view_layer.objects.active = result
    result.svrgs_share = 100
    bpy.context.view_layer.update()
    shown = part("operators.jobs.job_result").Shown(result).gaussians
    assert shown.count == before.count
    back = ~np.isin(np.arange(before.count), bridge.values(result, "svrgs:row"))
    np.testing.assert_allclose(shown.means[back], before.means[back], atol=1e-5)
    np.testing.assert_allclose(shown.sh[back], before.sh[back], atol=1e-5)


def test_splats_of_an_undecided_result_are_not_transformed(pruned):
    for obj in pruned:
        obj.hide_set(False)
        bpy.ops.object.select_all(action="DESELECT")
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj
        with pytest.raises(RuntimeError, match="Apply or discard the pruning result"):
            bpy.ops.svrgs.apply_transforms()


def test_the_default_name_is_that_of_the_splat(splat, tmp_path):
    operator = part("operators.io.export_ply")
    assert splat.name == "scene" and (DATA / "tiny").exists()
    assert operator.default_path(splat).name == "scene.spz"
    splat.name = "a/b:c"
    assert "/" not in operator.default_path(splat).name and operator.default_path(splat).suffix == ".spz"
