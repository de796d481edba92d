"""Meshes in the render engine: what they hide, their base colours, holdouts and shadow catchers."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from mathutils import Matrix
from mesh_objects import lit, lit_wall, material, shader_of, wall
from view_helpers import LEVEL, drawn, f12, view_of

pytestmark = pytest.mark.usefixtures("stage")
CENTRE = (30, 50)  # row, column of a pixel in the middle


@pytest.fixture
def alone(bridge, gaussians, stage, camera):
    """One Gaussian far behind the camera: the engine draws no scene without a splat."""
    return bridge.object_from_scene(
        "far", gaussians.select(np.arange(1)), stage.collection, Matrix.Translation((0, -999, 0))
    )


def link(material, source, target):
    material.node_tree.links.new(source, target)


def picture(name: str, pixels: np.ndarray):
    """An image of (H, W, 3) display sRGB, rows from the bottom."""
    height, width, _ = pixels.shape
    image = bpy.data.images.new(name, width, height)
    image.pixels.foreach_set(
        np.concatenate([pixels, np.ones((height, width, 1))], 2).astype(np.float32).reshape(-1)
    )
    return image


def before_wall(gaussians, stage, room, camera, depth: float):
    view = view_of(camera, stage).moved(room.matrix_world)
    return gaussians.select(gaussians.means @ view.viewmat[2, :3] + view.viewmat[2, 3] <= depth)


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_what_meshes_hide_is_hidden(tmp_path, stage, gaussians, room, camera, kind):
    """A wall across the view: the Gaussians before it over its colour. Hidden for the render, it is not
    there."""
    camera.data.type = kind
    without = f12(tmp_path / "without.png")
    obj = wall(camera, 3)
    before = before_wall(gaussians, stage, room, camera, 3)
    assert 100 < before.count < 2900
    expected = drawn(before, camera, room.matrix_world, background=tuple(lit_wall(camera)))["rgb"]
    assert np.abs(f12(tmp_path / "wall.png")[..., :3] - expected).max() <= LEVEL
    for hide in ("hide_render", "visible_camera"):
        setattr(obj, hide, hide == "hide_render")
        np.testing.assert_array_equal(f12(tmp_path / "hidden.png"), without)
        setattr(obj, hide, hide != "hide_render")


def test_edges_of_meshes_are_smooth(tmp_path, stage, alone, camera):
    """A tilted square is as the mean of 8 x 8 pixels of a picture of eight times the size, colours in display
    sRGB."""
    wall(camera, 3, half=0.6).matrix_world = camera.matrix_world @ Matrix.Rotation(0.3, 4, "Z")
    small = f12(tmp_path / "small.png")[..., 0]
    stage.render.resolution_percentage = 800
    large = f12(tmp_path / "large.png")[..., 0]
    mean = large.reshape(*small.shape[:1], 8, small.shape[1], 8).mean(axis=(1, 3))
    edge = (mean > 0.05) & (mean < 0.95 * mean.max())
    assert edge.sum() > 60
    assert np.abs(small - mean)[edge].mean() < 0.06 and np.abs(small - mean)[~edge].max() < 0.1


def test_the_colour_is_that_of_the_material(tmp_path, alone, camera):
    obj = wall(camera, 3, (0.1, 0.5, 0.9))
    for change in ("principled", "diffuse", "mixed", "no nodes", "none"):
        paint, expected = obj.data.materials[0], (0.1, 0.5, 0.9)
        tree = paint.node_tree if paint is not None else None
        if change in ("diffuse", "mixed"):
            output, diffuse = tree.get_output_node("ALL"), tree.nodes.new("ShaderNodeBsdfDiffuse")
            diffuse.inputs["Color"].default_value, expected = (0.7, 0.2, 0.1, 1), (0.7, 0.2, 0.1)
            mix = tree.nodes.new("ShaderNodeMixShader")
            link(paint, diffuse.outputs[0], mix.inputs[1])
            link(paint, (mix if change == "mixed" else diffuse).outputs[0], output.inputs["Surface"])
        elif change == "no nodes":
            tree.nodes.clear()
            paint.diffuse_color, expected = (0.3, 0.4, 0.5, 1), (0.3, 0.4, 0.5)
        elif change == "none":
            obj.data.materials.clear()
            expected = (0.8, 0.8, 0.8)
        np.testing.assert_allclose(
            f12(tmp_path / "wall.png")[CENTRE][:3], lit_wall(camera, expected), atol=LEVEL, err_msg=change
        )


@pytest.mark.parametrize("wires", ["direct", "named", "mapped", "mixed", "group", "generated"])
def test_the_texture_of_the_base_colour_is_shown(tmp_path, alone, camera, wires):
    """Four colours in the quarters of a wall that fills the view, which lies on the active UV map or on the
    named one."""
    camera.data.shift_x = camera.data.shift_y = 0
    obj = wall(camera, 3, half=3.0)
    paint, quarters = obj.data.materials[0], np.array([[(1, 0, 0), (0, 1, 0)], [(0, 0, 1), (1, 1, 0)]], float)
    tree, base = paint.node_tree, shader_of(paint).inputs["Base Color"]
    node = tree.nodes.new("ShaderNodeTexImage")
    node.image = picture("quarters", np.repeat(np.repeat(quarters, 64, 0), 64, 1))
    node.interpolation = "Linear"
    if wires == "group":
        group = bpy.data.node_groups.new("inside", "ShaderNodeTree")
        tree.nodes.remove(node)
        node = group.nodes.new("ShaderNodeTexImage")
        node.image = bpy.data.images["quarters"]
        group.interface.new_socket("Color", in_out="OUTPUT", socket_type="NodeSocketColor")
        group.links.new(node.outputs["Color"], group.nodes.new("NodeGroupOutput").inputs[0])
        outside = tree.nodes.new("ShaderNodeGroup")
        outside.node_tree = group
        link(paint, outside.outputs[0], base)
    elif wires == "mixed":
        between = tree.nodes.new("ShaderNodeGamma")
        link(paint, node.outputs["Color"], between.inputs["Color"])
        link(paint, between.outputs["Color"], base)
    else:
        link(paint, node.outputs["Color"], base)
    if wires == "named":
        obj.data.uv_layers.new(name="other").uv.foreach_set("vector", [1, 0, 0, 0, 0, 1, 1, 1])  # mirrored
        uv_map = tree.nodes.new("ShaderNodeUVMap")
        uv_map.uv_map = "other"
        link(paint, uv_map.outputs[0], node.inputs["Vector"])
        quarters = quarters[:, ::-1]
    elif wires in ("mapped", "generated"):
        coordinates, mapping = tree.nodes.new("ShaderNodeTexCoord"), tree.nodes.new("ShaderNodeMapping")
        link(paint, coordinates.outputs["UV" if wires == "mapped" else "Generated"], mapping.inputs["Vector"])
        link(paint, mapping.outputs[0], node.inputs["Vector"])
        mapping.inputs["Location"].default_value = (0, 0.5, 0)
        mapping.inputs["Scale"].default_value = (1, -1, 1)
        quarters = quarters if wires == "mapped" else np.full((2, 2, 3), quarters.mean(axis=(0, 1)))
        quarters = np.roll(quarters[::-1], 1, axis=0)
    seen = f12(tmp_path / "wall.png")
    found = seen[[[45], [15]], [25, 75], :3]  # below, above the middle
    np.testing.assert_allclose(
        found, [[lit_wall(camera, color) for color in row] for row in quarters], atol=3 * LEVEL
    )


def test_a_changed_image_is_shown(tmp_path, alone, camera):
    obj = wall(camera, 3)
    paint = obj.data.materials[0]
    node = paint.node_tree.nodes.new("ShaderNodeTexImage")
    link(paint, node.outputs["Color"], shader_of(paint).inputs["Base Color"])
    path = tmp_path / "paint.png"
    for color in ((1, 0, 0), (0, 0, 1)):
        made = picture("made", np.full((4, 4, 3), color))
        made.filepath_raw, made.file_format = str(path), "PNG"
        made.save()
        if node.image is None:
            node.image = bpy.data.images.load(str(path))
        node.image.reload()
        bpy.context.view_layer.update()
        np.testing.assert_allclose(
            f12(tmp_path / "wall.png")[CENTRE][:3], lit_wall(camera, color), atol=LEVEL
        )


@pytest.mark.parametrize("domain", ["POINT", "CORNER"])
@pytest.mark.parametrize("kind", ["FLOAT_COLOR", "BYTE_COLOR"])
@pytest.mark.parametrize("named", [True, False])
def test_colour_attributes_are_shown(tmp_path, alone, camera, domain, kind, named):
    obj = wall(camera, 3)
    attribute = obj.data.color_attributes.new("hue", kind, domain)
    attribute.data.foreach_set("color", np.tile([0.2, 0.7, 0.1, 1], 4).astype(np.float32))
    obj.data.color_attributes.render_color_index = 0
    paint = obj.data.materials[0]
    node = paint.node_tree.nodes.new("ShaderNodeVertexColor")
    node.layer_name = "hue" if named else ""
    link(paint, node.outputs["Color"], shader_of(paint).inputs["Base Color"])
    np.testing.assert_allclose(
        f12(tmp_path / "wall.png")[CENTRE][:3], lit_wall(camera, (0.2, 0.7, 0.1)), atol=2 * LEVEL
    )


def test_smooth_and_mirrored_meshes_are_lit_from_above(tmp_path, alone, stage, camera):
    """The middle of a smooth ball faces the camera, whatever its triangles do."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=12, ring_count=8, radius=0.8)
    ball = bpy.context.object
    bpy.ops.object.shade_smooth()
    camera.data.shift_x = camera.data.shift_y = 0
    for scale in ((1, 1, 1), (-1, 1, 1), (0.5, -2, 1)):
        ball.matrix_world = (
            camera.matrix_world @ Matrix.Translation((0, 0, -4)) @ Matrix.Diagonal((*scale, 1))
        )
        bpy.context.view_layer.update()
        np.testing.assert_allclose(
            f12(tmp_path / "ball.png")[CENTRE][:3],
            lit((0.8, 0.8, 0.8), camera.matrix_world.col[2].xyz),
            atol=6 * LEVEL,
        )


def test_meshes_of_instances_and_curves_are_there(tmp_path, alone, stage, camera):
    inner = bpy.data.collections.new("inner")
    obj = wall(camera, 3, half=0.3)
    stage.collection.objects.unlink(obj)
    inner.objects.link(obj)
    for place in (-1.2, 1.2):
        copy = bpy.data.objects.new("copy", None)
        copy.instance_type, copy.instance_collection = "COLLECTION", inner
        copy.location = camera.matrix_world.to_3x3() @ Matrix.Identity(3).col[0] * place
        stage.collection.objects.link(copy)
    covered = f12(tmp_path / "copies.png")[..., 0] > 0.3
    middle = covered[:, 40:60].sum()
    assert covered[:, :40].sum() > 50 and covered[:, 60:].sum() > 50 and middle == 0
    curve = bpy.data.curves.new("text", "FONT")
    curve.body, curve.size = "M", 3
    text = bpy.data.objects.new("text", curve)
    text.matrix_world = camera.matrix_world @ Matrix.Translation((-1, -1, -3))
    stage.collection.objects.link(text)
    assert (f12(tmp_path / "text.png")[..., 0] > 0.3)[:, 40:60].sum() > 50


@pytest.mark.parametrize("transparent", [False, True])
@pytest.mark.parametrize("of", ["object", "collection"])
def test_a_holdout_cuts_a_hole(tmp_path, stage, gaussians, room, camera, of, transparent):
    stage.render.film_transparent = transparent
    stage.svrgs_view.background = (0, 0, 0) if transparent else (0.2, 0.3, 0.4)
    obj = wall(camera, 1.5)
    if of == "object":
        obj.is_holdout = True
    else:
        held = bpy.data.collections.new("held")
        stage.collection.children.link(held)
        stage.collection.objects.unlink(obj)
        held.objects.link(obj)
        bpy.context.view_layer.layer_collection.children["held"].holdout = True
    expected = drawn(
        before_wall(gaussians, stage, room, camera, 1.5), camera, room.matrix_world, ("rgb", "alpha")
    )
    seen = f12(tmp_path / "holdout.png")
    np.testing.assert_allclose(seen[..., 3], expected["alpha"], atol=LEVEL)
    np.testing.assert_allclose(seen[..., :3] * seen[..., 3:], expected["rgb"], atol=1.5 * LEVEL)
    assert (seen[..., 3] < 0.5).mean() > 0.1


def test_a_shadow_catcher_hides_nothing(tmp_path, room, camera):
    without = f12(tmp_path / "without.png")
    obj = wall(camera, 1.5)
    assert np.abs(f12(tmp_path / "wall.png") - without).max() > 0.5
    obj.is_shadow_catcher = True
    np.testing.assert_array_equal(f12(tmp_path / "catcher.png"), without)


def test_a_material_per_face_and_per_object_counts(tmp_path, alone, camera):
    obj = wall(camera, 3, half=3.0)
    mesh = obj.data
    mesh.materials.append(material("second", (0, 0, 1)))
    mesh.polygons[0].material_index = 1
    np.testing.assert_allclose(
        f12(tmp_path / "face.png")[CENTRE][:3], lit_wall(camera, (0, 0, 1)), atol=LEVEL
    )
    obj.material_slots[1].link, obj.material_slots[1].material = "OBJECT", material("own", (0, 1, 0))
    np.testing.assert_allclose(f12(tmp_path / "own.png")[CENTRE][:3], lit_wall(camera, (0, 1, 0)), atol=LEVEL)
