"""Blender 5.3's own splats: what its readers make of our files, and what we make of its splats. Skipped in
Blenders that have none."""

from __future__ import annotations

import dataclasses

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn, follow, set_up
from mathutils import Quaternion

pytestmark = pytest.mark.skipif(
    not hasattr(bpy.types, "GeometryNodeImportSPZ"), reason="this Blender has no splats of its own"
)


@pytest.fixture
def scene(bridge):
    """The scene of a file, in the order of the file."""
    return part("svrgs_addon.files.registry").read_scene(DATA / "tiny/scene.ply")


def own_import(file) -> bpy.types.Object:
    """The splat that Blender itself makes of a file."""
    readers = {
        ".ply": bpy.ops.wm.ply_import, ".spz": bpy.ops.wm.spz_import, ".glb": bpy.ops.import_scene.gltf,
        ".usd": bpy.ops.wm.usd_import,
    }  # fmt: skip
    readers[file.suffix](filepath=str(file))
    (obj,) = (obj for obj in bpy.data.objects if obj.type == "POINTCLOUD")
    assert obj.data.type == "GAUSSIAN_SPLAT"
    return obj


def through_nodes(file) -> bpy.types.Object:
    """An object whose geometry nodes read the file."""
    nodes = bpy.data.node_groups.new("splat", "GeometryNodeTree")
    nodes.interface.new_socket("Geometry", in_out="OUTPUT", socket_type="NodeSocketGeometry")
    reader, end = nodes.nodes.new("GeometryNodeImportSPZ"), nodes.nodes.new("NodeGroupOutput")
    reader.inputs["Path"].default_value = str(file)
    nodes.links.new(reader.outputs[0], end.inputs[0])
    obj = bpy.data.objects.new("nodes", bpy.data.meshes.new("nodes"))
    bpy.context.collection.objects.link(obj)
    obj.modifiers.new("splat", "NODES").node_group = nodes
    return obj


def test_its_coordinates_stay_those_of_the_file_when_gaussians_are_deleted(scene, bridge, tmp_path):
    obj = own_import(DATA / "tiny/scene.ply")
    bpy.context.view_layer.objects.active = obj
    obj.select_set(True)
    part("operators.data.selection").change(obj, np.arange(scene.count) < 50, "SET")
    bpy.ops.svrgs.delete_gaussians(what="SELECTED")
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "out.ply"))
    found = part("svrgs_addon.files.registry").read_scene(tmp_path / "out.ply")
    np.testing.assert_array_equal(found.means, scene.means[50:])


def test_a_splat_of_blenders_own_ply_reader_is_exported_as_its_file_says(scene, bridge, tmp_path):
    """As far as float32 allows: Blender stores activated values."""
    obj = own_import(DATA / "tiny/scene.ply")
    assert bridge.is_splat(obj) and bridge.count(obj) == scene.count
    bpy.context.view_layer.objects.active = obj
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "out.ply"))
    found = part("svrgs_addon.files.registry").read_scene(tmp_path / "out.ply")
    np.testing.assert_array_equal(found.means, scene.means)
    same_splat(found, scene)


@pytest.mark.parametrize("degree", [0, 1, 2, 3])
@pytest.mark.parametrize("suffix", [".spz", ".glb", ".usd"])
def test_blenders_own_readers_take_what_is_exported_and_give_it_back(suffix, degree, scene, bridge, tmp_path):
    """Also a splat without SH, which is not read as SPZ 4. They turn y down to z up."""
    registry = part("svrgs_addon.files.registry")
    sh = np.repeat(scene.sh, 4, axis=1)[:, : (degree + 1) ** 2]
    file = tmp_path / f"a{suffix}"
    registry.write_scene(file, dataclasses.replace(scene, sh=np.ascontiguousarray(sh)))
    bpy.ops.svrgs.import_ply(filepath=str(file))
    ours = placed_means(bridge, bpy.context.object)
    bpy.data.objects.remove(bpy.context.object)
    obj = own_import(file)
    np.testing.assert_allclose(placed_means(bridge, obj), ours, atol=1e-6)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "out.ply"))
    read, found = registry.read_scene(file), registry.read_scene(tmp_path / "out.ply")
    assert found.sh_degree == degree
    same_splat(found, read)


def same_splat(found, wanted):
    """As far as float32 allows: Blender stores activated values, and turns them."""
    np.testing.assert_allclose(found.means, wanted.means, atol=1e-6)
    np.testing.assert_allclose(found.sh, wanted.sh, atol=1e-5)
    # of glTF, Blender names the axes of a Gaussian in another order
    sizes = [np.sort(one.log_scales, axis=1) for one in (found, wanted)]
    np.testing.assert_allclose(*sizes, atol=2e-6)
    # SPZ stores 0 and 1, whose logits are infinite
    logits = [one.opacity_logits.clip(-6, 6) for one in (found, wanted)]
    np.testing.assert_allclose(*logits, rtol=1e-6, atol=1e-5)
    assert np.isfinite(found.opacity_logits).all()
    # half turns about the axes of a Gaussian do not change it
    shapes = covariances(wanted)
    np.testing.assert_allclose(covariances(found), shapes, rtol=1e-4, atol=1e-6 * shapes.max())


def covariances(scene) -> np.ndarray:
    turns = np.array([Quaternion(quat).normalized().to_matrix() for quat in scene.quats.tolist()])
    axes = turns * np.exp(scene.log_scales)[:, None]
    return axes @ axes.transpose(0, 2, 1)


def placed_means(bridge, obj) -> np.ndarray:
    matrix = np.array(obj.matrix_world)
    return bridge.scene_from_object(obj).means @ matrix[:3, :3].T + matrix[:3, 3]


@pytest.mark.parametrize("suffix", [".ply", ".spz", ".glb"])
def test_a_splat_of_blenders_own_reader_is_joined_to_its_cameras(suffix, scene, bridge, tmp_path):
    part("svrgs_addon.files.registry").write_scene(tmp_path / f"a{suffix}", scene)
    obj = own_import(tmp_path / f"a{suffix}")
    bpy.context.view_layer.objects.active = obj
    before = placed_means(bridge, obj)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"), level=False)
    match = part("operators.scene.camera_match")
    match.check()
    assert match.sentence(bpy.context) == ""
    np.testing.assert_allclose(placed_means(bridge, obj), before, atol=1e-5)
    found = bridge.scene_from_object(obj).means
    np.testing.assert_allclose(np.sort(found, axis=0), np.sort(scene.means, axis=0), atol=1e-3)


def test_a_splat_of_geometry_nodes_is_drawn_and_made_an_object(scene, bridge, tmp_path):
    part("svrgs_addon.files.registry").write_scene(tmp_path / "a.spz", scene)
    bpy.context.view_layer.objects.active = through_nodes(tmp_path / "a.spz")
    bpy.context.view_layer.update()
    visible = part("operators.data.visible_splats")
    assert "Geometry nodes make the splat of 'nodes'" in drawn("scene")
    placed = visible.splats(bpy.context.evaluated_depsgraph_get())
    assert placed.scene.count == scene.count
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.visual_geometry_to_objects()
    (made,) = (obj for obj in bpy.data.objects if bridge.is_splat(obj))
    assert bridge.count(made) == scene.count
    bpy.context.view_layer.objects.active = made
    assert "Geometry nodes" not in drawn("scene")


@pytest.mark.parametrize("suffix", [".ply", ".spz"])
def test_a_splat_of_blenders_own_reader_is_pruned_and_exported_like_its_file(
    suffix, scene, bridge, watch, tmp_path
):
    registry = part("svrgs_addon.files.registry")
    registry.write_scene(tmp_path / f"a{suffix}", scene)
    obj = own_import(tmp_path / f"a{suffix}")
    bpy.context.view_layer.objects.active = obj
    set_up({"effort": "QUICK", "goal": "COUNT", "count": 60})
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: bpy.context.object != obj)
    result = bpy.context.object
    assert result.data.type == "GAUSSIAN_SPLAT" and result.matrix_world == obj.matrix_world
    bpy.ops.svrgs.apply()
    for kept in ("a.ply", "a.spz"):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"out-{kept}"))
        found = registry.read_scene(tmp_path / f"out-{kept}")
        box = scene.means.min(axis=0) - 0.2, scene.means.max(axis=0) + 0.2
        assert found.count == 60 and (found.means > box[0]).all() and (found.means < box[1]).all()
