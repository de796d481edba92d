"""Whatever Blender does with splats, what is looked at stays right: F12, viewport, export and pruning, for
two splats with SH degree 3."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import part
from mathutils import Euler, Matrix
from view_helpers import add_geometry_nodes, drawn, f12

PLACES = {"a": Matrix(), "b": Matrix.LocRotScale((2, 1, 0.5), Euler((1.0, 2.0, 3.0)), (1.7, 1.7, 1.7))}


@pytest.fixture
def two(stage, bridge, camera):
    """Objects a and b in the middle of a picture, b rotated and scaled."""
    rng, scene_of = np.random.default_rng(5), part("svrgs_addon.scene.gaussians").Scene.of
    made = {}
    for name, place in PLACES.items():
        count = 300
        arrays = (
            rng.normal(0, 0.7, (count, 3)),
            rng.normal(-2.2, 0.5, (count, 3)),
            rng.normal(size=(count, 4)),
            rng.normal(1, 1, count),
        )
        made[name] = bridge.object_from_scene(
            name,
            scene_of(*arrays, rng.normal(0, 0.35, (count, 16, 3))),
            stage.collection,
            place @ bridge.AXES,
        )
        made[name].select_set(False)
    bpy.context.view_layer.update()
    return made["a"], made["b"]


def activate(*objects):
    bpy.ops.object.select_all(action="DESELECT")
    for obj in reversed(objects):
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj


# --- what is looked at: each gives the Gaussians in Blender's world


def in_world(parts) -> object:
    """The Gaussians of [(scene, matrix to the world)], sorted by opacity, which no operation changes;
    instances by place."""
    transformed = part("svrgs_addon.scene.affine").transformed
    concatenated = part("svrgs_addon.scene.concatenate").concatenated
    scene = concatenated([transformed(scene, np.array(matrix)) for scene, matrix in parts])
    return scene.select(np.lexsort((scene.means[:, 0], scene.opacity_logits)))


def splat_objects() -> list:
    return [obj for obj in bpy.context.scene.objects if part("operators.data.splat_object").is_splat(obj)]


def in_render(_) -> object:
    graph = part("operators.data.visible_splats")
    placed = graph.splats(bpy.context.evaluated_depsgraph_get())
    return in_world([(placed.scene, placed.matrix)])


def in_viewport(_) -> object:
    graph, cache = part("operators.data.visible_splats"), part("operators.view.scene_cache")
    context = SimpleNamespace(view_layer=bpy.context.view_layer, space_data=None)
    return in_world([(cache.read(obj), matrix) for obj, matrix in graph.splats_in_view(context)])


def in_export(tmp_path) -> object:
    bridge, read = part("operators.data.splat_object"), part("svrgs_addon.files.ply").read_ply
    parts = []
    for obj in splat_objects():
        bpy.context.view_layer.objects.active = obj
        assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"{obj.name}.ply")) == {"FINISHED"}
        parts.append((read(tmp_path / f"{obj.name}.ply"), bridge.AXES))
    return in_world(parts)


def in_job(_) -> object:
    bridge = part("operators.data.splat_object")
    return in_world([(bridge.scene_from_object(obj), obj.matrix_world) for obj in splat_objects()])


LOOKS = {"render": in_render, "viewport": in_viewport, "export": in_export, "job": in_job}


def covariances(scene) -> np.ndarray:
    axes = (
        part("svrgs_addon.scene.rotations").rotation_matrices(scene.quats)
        * np.exp(scene.log_scales.astype(np.float64))[:, None]
    )
    return axes @ axes.transpose(0, 2, 1)


def assert_looks_like(found, expected):
    assert found.count == expected.count
    np.testing.assert_allclose(found.means, expected.means, atol=1e-5)
    a, b = covariances(found), covariances(expected)
    np.testing.assert_allclose(a, b, atol=1e-5 * np.abs(b).max())
    np.testing.assert_allclose(found.sh, expected.sh, atol=1e-5)
    np.testing.assert_allclose(found.opacity_logits, expected.opacity_logits, atol=1e-5)


# --- what is done; each leaves the picture as it was


def apply_with_blender(a, b):
    activate(b)
    bpy.ops.object.transform_apply()


def apply_with_ours(a, b):
    activate(a, b)
    assert bpy.ops.svrgs.apply_transforms() == {"FINISHED"}
    assert not np.array(b.matrix_world - Matrix()).any()


def join_with_blender(a, b):
    activate(a, b)
    bpy.ops.object.join()


def join_with_ours(a, b):
    activate(a, b)
    assert bpy.ops.svrgs.join_splats() == {"FINISHED"}
    assert splat_objects() == [a]


def apply_and_join(a, b):
    apply_with_blender(a, b)
    join_with_blender(a, b)


def join_a_copy(a, b):
    """Parts of one splat in two places, one of them mirrored."""
    half = part("operators.data.splat_object").scene_from_object(b).select(np.arange(0, 300, 2))
    other = part("operators.data.splat_object").scene_from_object(b).select(np.arange(1, 300, 2))
    part("operators.data.splat_object").replace_gaussians(b, half)
    copy = part("operators.data.splat_object").object_from_scene(
        "copy", other, bpy.context.collection, b.matrix_world
    )
    bpy.context.view_layer.update()
    activate(copy, b, a)
    bpy.ops.object.join()


def apply_then_reload(a, b):
    apply_with_blender(a, b)
    file = bpy.app.tempdir + "reload.blend"
    bpy.ops.wm.save_as_mainfile(filepath=file)
    bpy.ops.wm.open_mainfile(filepath=file)


def apply_then_write(a, b):
    apply_with_blender(a, b)
    assert bpy.ops.svrgs.write_shapes() == {"FINISHED"}
    assert not part("operators.data.splat_object").count_moved(b)


def rotate_in_edit_mode_and_back(a, b):
    """Some points are rotated, by their coordinates, and the others are left."""
    some = np.random.default_rng(0).random(300) < 0.4
    positions = part("operators.data.splat_object").values(b, "position")
    turn = np.array(Euler((0.3, 0.4, 0.5)).to_matrix())
    for matrix in (turn, turn.T):
        positions[some] = positions[some] @ matrix.T
        b.data.attributes["position"].data.foreach_set(
            "vector", np.ascontiguousarray(positions, np.float32).reshape(-1)
        )
        b.data.update_tag()
        if matrix is turn:
            assert part("operators.data.splat_object").count_moved(b) == some.sum()


def move_and_duplicate_linked(a, b):
    b.hide_render = b.hide_viewport = True
    copy = b.copy()
    copy.hide_render = copy.hide_viewport = False
    bpy.context.collection.objects.link(copy)
    bpy.data.objects.remove(b)


def separate(a, b):
    activate(b)
    selected = np.random.default_rng(0).random(300) < 0.4
    if b.type == "MESH":
        b.data.vertices.foreach_set("select", selected)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.separate(type="SELECTED")
    else:
        b.data.attributes.new(".selection", "BOOLEAN", "POINT").data.foreach_set("value", selected)
        bpy.ops.object.mode_set(mode="EDIT")
        try:
            bpy.ops.pointcloud.separate()
        except (AttributeError, RuntimeError):
            pytest.skip("this Blender cannot separate points of a point cloud")
        finally:
            bpy.ops.object.mode_set(mode="OBJECT")
    if b.mode == "EDIT":
        bpy.ops.object.mode_set(mode="OBJECT")


SAME = (
    apply_with_blender, apply_with_ours, join_with_blender, join_with_ours, apply_and_join, join_a_copy,
    apply_then_reload, apply_then_write,
    rotate_in_edit_mode_and_back, move_and_duplicate_linked, separate,
)  # fmt: skip


@pytest.mark.parametrize("operation", SAME, ids=lambda operation: operation.__name__)
def test_nothing_seems_to_change(two, tmp_path, operation):
    if (
        operation in (join_with_blender, apply_and_join, join_a_copy)
        and two[0].type == "POINTCLOUD"
        and bpy.app.version < (5, 0)
    ):
        pytest.skip("this Blender cannot join point clouds")
    expected = in_render(None)
    operation(*two)
    bpy.context.view_layer.update()
    for name, look in LOOKS.items():
        found = look(tmp_path)
        print(name)
        assert_looks_like(found, expected)


def test_f12_is_the_same_before_and_after(two, tmp_path, camera, stage):
    before = f12(tmp_path / "before.png")
    assert before[..., :3].std() > 0.05
    graph = part("operators.data.visible_splats")
    look = lambda: drawn(
        *(lambda p: (p.scene, camera, p.matrix))(graph.splats(bpy.context.evaluated_depsgraph_get()))
    )["rgb"]
    apply_with_blender(*two)
    join_with_ours(*two)
    after = f12(tmp_path / "after.png")
    assert np.abs(before - after).max() <= 1 / 255 + 1e-6
    assert (before != after).any(axis=-1).mean() < 0.01
    assert look().shape[2] == 3


# --- what changes the picture, in a known way


def transform_nodes(group, geometry):
    node = group.nodes.new("GeometryNodeTransform")
    node.inputs["Rotation"].default_value, node.inputs["Scale"].default_value = (0.5, 0.6, 0.7), (2, 2, 2)
    group.links.new(geometry, node.inputs["Geometry"])
    return node.outputs[0]


def crop_nodes(group, geometry):
    """Deletes the points with x > 0."""
    position, parts = map(group.nodes.new, ("GeometryNodeInputPosition", "ShaderNodeSeparateXYZ"))
    compare, delete = map(group.nodes.new, ("FunctionNodeCompare", "GeometryNodeDeleteGeometry"))
    compare.operation = "GREATER_THAN"
    group.links.new(position.outputs[0], parts.inputs[0])
    group.links.new(parts.outputs["X"], compare.inputs[0])
    group.links.new(geometry, delete.inputs["Geometry"])
    group.links.new(compare.outputs[0], delete.inputs["Selection"])
    return delete.outputs[0]


def scatter_nodes(realized: bool):
    """The splat on each of four points of a square."""

    def build(group, geometry):
        grid, instance = map(group.nodes.new, ("GeometryNodeMeshGrid", "GeometryNodeInstanceOnPoints"))
        for name, value in {"Size X": 4.0, "Size Y": 4.0, "Vertices X": 2, "Vertices Y": 2}.items():
            grid.inputs[name].default_value = value
        instance.inputs["Rotation"].default_value = (0.2, 0.1, 0.9)
        group.links.new(grid.outputs[0], instance.inputs["Points"])
        group.links.new(geometry, instance.inputs["Instance"])
        if not realized:
            return instance.outputs[0]
        realize = group.nodes.new("GeometryNodeRealizeInstances")
        group.links.new(instance.outputs[0], realize.inputs[0])
        return realize.outputs[0]

    return build


def scattered(scene, world) -> list:
    turn = Euler((0.2, 0.1, 0.9)).to_matrix().to_4x4()
    return [(scene, world @ Matrix.Translation((x, y, 0)) @ turn) for x in (-2, 2) for y in (-2, 2)]


def transformed_by_nodes(scene, world) -> list:
    return [(scene, world @ Matrix.LocRotScale((0, 0, 0), Euler((0.5, 0.6, 0.7)), (2, 2, 2)))]


def cropped(scene, world) -> list:
    return [(scene.select(scene.means[:, 0] <= 0), world)]


MODIFIERS = {
    "transform": (transform_nodes, transformed_by_nodes), "crop": (crop_nodes, cropped),
    "scatter": (scatter_nodes(realized=False), scattered), "scatter_realized": (scatter_nodes(realized=True),
    scattered),
}  # fmt: skip


@pytest.mark.parametrize("name", MODIFIERS)
@pytest.mark.parametrize("look", ["render", "viewport", "export"])
def test_modifiers_are_seen_and_exported(two, tmp_path, bridge, name, look):
    build, expect = MODIFIERS[name]
    a, b = two
    expected = in_world(
        [(bridge.scene_from_object(a), a.matrix_world), *expect(bridge.scene_from_object(b), b.matrix_world)]
    )
    add_geometry_nodes(b, build)
    bpy.context.view_layer.update()
    assert_looks_like(LOOKS[look](tmp_path), expected)


def test_all_stored_leaves_modifiers_out(two, tmp_path, bridge, ply):
    _, b = two
    add_geometry_nodes(b, crop_nodes)
    activate(b)
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "all.ply"), what="STORED", space="LOCAL")
    assert ply.read_ply(tmp_path / "all.ply").means.tobytes() == bridge.scene_from_object(b).means.tobytes()


def test_a_mirrored_splat_is_mirrored_everywhere(two, tmp_path, bridge):
    a, b = two
    mirror = Matrix.Diagonal((-1, 1, 1, 1))
    expected = in_world(
        [
            (bridge.scene_from_object(a), a.matrix_world),
            (bridge.scene_from_object(b), mirror @ b.matrix_world),
        ]
    )
    b.matrix_world = mirror @ b.matrix_world
    bpy.context.view_layer.update()
    for look in LOOKS.values():
        assert_looks_like(look(tmp_path), expected)
    apply_with_blender(a, b)
    bpy.context.view_layer.update()
    for look in LOOKS.values():
        assert_looks_like(look(tmp_path), expected)


def test_instanced_collections_are_seen(two, tmp_path, bridge):
    a, b = two
    collection = bpy.data.collections.new("instanced")
    collection.objects.link(b)
    bpy.context.scene.collection.objects.unlink(b)
    empty = bpy.data.objects.new("empty", None)
    empty.instance_type, empty.instance_collection = "COLLECTION", collection
    empty.matrix_world = place = Matrix.LocRotScale((0, 3, 0), Euler((0.1, 0.2, 0.3)), (1.5, 1.5, 1.5))
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    expected = in_world(
        [(bridge.scene_from_object(a), a.matrix_world), (bridge.scene_from_object(b), place @ b.matrix_world)]
    )
    for look in (in_render, in_viewport):
        assert_looks_like(look(tmp_path), expected)


# --- the notice, and what is refused


def test_the_panel_says_that_shapes_did_not_follow(two):
    transforms = part("operators.scene.splat_transforms")
    a, b = two
    assert transforms.moved_count(b) == 0
    apply_with_blender(a, b)
    bpy.context.view_layer.update()
    assert transforms.moved_count(b) == 300 and transforms.moved_count(a) == 0
    bpy.ops.svrgs.write_shapes()
    assert transforms.moved_count(b) == 0


def test_a_splat_without_stored_positions_gets_them(two, bridge):
    _, b = two
    b.data.attributes.remove(b.data.attributes["svrgs:position"])
    b.data.update_tag()
    bpy.context.view_layer.update()
    np.testing.assert_array_equal(bridge.values(b, "svrgs:position"), bridge.values(b, "position"))


def test_moving_points_one_by_one_leaves_shapes(two, bridge):
    _, b = two
    before, positions = bridge.scene_from_object(b), bridge.values(b, "position")
    positions += np.random.default_rng(1).normal(0, 0.3, positions.shape).astype(np.float32)
    b.data.attributes["position"].data.foreach_set("vector", positions.reshape(-1))
    after = bridge.scene_from_object(b)
    assert after.quats.tobytes() == before.quats.tobytes() and after.sh.tobytes() == before.sh.tobytes()
    assert bridge.count_moved(b) == 0


def test_shared_data_and_mixed_antialiasing_are_refused(two, bridge):
    a, b = two
    copy = b.copy()
    bpy.context.collection.objects.link(copy)
    activate(b)
    with pytest.raises(RuntimeError, match="single-user first"):
        bpy.ops.svrgs.apply_transforms()
    bpy.data.objects.remove(copy)
    from dataclasses import replace

    bridge.replace_gaussians(a, replace(bridge.scene_from_object(a), antialiased=True))
    activate(a, b)
    with pytest.raises(RuntimeError, match="antialiasing"):
        bpy.ops.svrgs.join_splats()
    assert len(splat_objects()) == 2


def test_the_file_goes_where_the_object_went(two, tmp_path, ply, bridge):
    """Coordinates 'Imported File': what the user has moved is moved, and what the import has turned is
    not."""
    _, b = two
    scene = bridge.scene_from_object(b)
    expected = part("svrgs_addon.scene.affine").transformed(
        scene, np.array(bridge.AXES.inverted() @ b.matrix_world)
    )
    activate(b)
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "moved.ply"))
    assert_looks_like(ply.read_ply(tmp_path / "moved.ply"), expected)
