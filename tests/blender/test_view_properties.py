"""Looking at splats: the render engine against `svrgs render` and the rasterizer, images of masks and comparisons."""

from __future__ import annotations

import contextlib
import json
import math
import types
import typing
from dataclasses import replace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from mathutils import Matrix

LEVEL = 1 / 255 + 1e-6


@pytest.fixture(autouse=True)
def stage():
    """Blender as a user finds it, with the engine chosen and colours as they are."""
    scene = bpy.context.scene
    render = scene.render
    render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    render.image_settings.file_format, render.image_settings.color_mode, render.image_settings.color_depth = "PNG", "RGBA", "8"
    render.resolution_x, render.resolution_y, render.resolution_percentage, render.pixel_aspect_x = 101, 61, 100, 1
    render.dither_intensity = 1.0  # as Blender has it
    render.use_border = render.use_crop_to_border = render.film_transparent = False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.23, 0.71, 0.1, 0.55
    looking = scene.svrgs_looking
    looking.background, looking.original, looking.pruned, looking.compare_camera = (0, 0, 0), None, None, None
    return scene


@pytest.fixture
def gaussians():
    return part("svrgs_addon.bench.scenes").room(3000)


@pytest.fixture
def splat(bridge, gaussians, stage):
    obj = bridge.object_from_scene("room", gaussians, stage.collection)
    bpy.context.view_layer.objects.active = obj
    return obj


@pytest.fixture
def camera(stage):
    data = bpy.data.cameras.new("camera")
    obj = stage.camera = bpy.data.objects.new("camera", data)
    stage.collection.objects.link(obj)
    obj.location, obj.rotation_euler = (0.5, -6, 0.7), (1.5, 0.1, 0.2)
    data.lens, data.shift_x, data.shift_y = 30, 0.1, -0.07
    bpy.context.view_layer.update()
    return obj


def f12(path) -> np.ndarray:
    """(H, W, 4) of the saved PNG, rows from the top."""
    bpy.context.scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)
    image = bpy.data.images.load(str(path), check_existing=False)
    return pixels(image)


def pixels(image) -> np.ndarray:
    width, height = image.size
    values = np.empty(width * height * image.channels, np.float32)
    image.pixels.foreach_get(values)
    return values.reshape(height, width, image.channels)[::-1]


def drawn(bridge, scene, camera, matrix, outputs=("rgb",), **options) -> dict:
    """What the rasterizer makes of a scene under a matrix, seen by Blender's camera; rgb as 8 bits show it."""
    bpy.context.view_layer.update()
    native = part("svrgs_addon.native")
    view = bridge.camera_from_object(camera, bpy.context.scene, bridge.render_size(bpy.context.scene)).moved(matrix)
    images = native.Rasterizer().forward(scene, view, native.RenderOptions(**options), outputs=outputs)
    return images | {"rgb": np.round(np.clip(images["rgb"], 0, 1) * 255) / 255} if "rgb" in images else images


# --- the engine


def test_f12_is_svrgs_render(tmp_path, stage):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    cameras = sorted((obj for obj in bpy.data.objects if obj.type == "CAMERA"), key=lambda obj: obj.name)
    for obj in cameras[::4]:
        stage.camera = obj
        rendered = f12(tmp_path / "f12.png")
        expected = pixels(bpy.data.images.load(str(DATA / f"renders/{obj.name[:-4]}.rgb.png")))
        assert rendered.shape[:2] == expected.shape[:2]
        assert np.abs(rendered[..., :3] - expected[..., :3]).max() <= LEVEL


@pytest.mark.parametrize("change", ["plain", "percentage", "aspect", "portrait", "background", "scaled", "orthographic"])
def test_f12_is_the_rasterizers_picture(tmp_path, stage, bridge, gaussians, splat, camera, change):
    background = (0.0, 0.0, 0.0)
    if change == "percentage":
        stage.render.resolution_percentage = 53
    elif change == "aspect":
        stage.render.pixel_aspect_x, camera.data.sensor_fit = 1.3, "VERTICAL"
    elif change == "portrait":
        stage.render.resolution_x, stage.render.resolution_y = 61, 101
    elif change == "background":
        background = stage.svrgs_looking.background = (0.25, 0.5, 0.75)
    elif change == "orthographic":
        stage.render.pixel_aspect_x, camera.data.type, camera.data.ortho_scale = 1.3, "ORTHO", 4.0
        splat.matrix_world = splat.matrix_world @ Matrix.Scale(0.7, 4)
    elif change == "scaled":
        splat.matrix_world = Matrix.Translation((0, 1, 0)) @ Matrix.Rotation(0.4, 4, "Z") @ splat.matrix_world @ Matrix.Scale(0.7, 4)
    expected = drawn(bridge, gaussians, camera, splat.matrix_world, background=tuple(background))["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_dither_stays_as_it_was(tmp_path, stage, splat, camera):
    stage.render.dither_intensity = 0.75
    f12(tmp_path / "f12.png")
    assert stage.render.dither_intensity == 0.75
    camera.data.type = "PANO"
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert stage.render.dither_intensity == 0.75


def test_a_border_shows_the_same_pixels(tmp_path, stage, splat, camera):
    whole = f12(tmp_path / "whole.png")
    stage.render.use_border = True
    bordered = f12(tmp_path / "border.png")
    inside = bordered[..., :3].any(axis=2)
    assert 0.1 < inside.mean() < 0.3
    np.testing.assert_array_equal(bordered[inside], whole[inside])
    stage.render.use_crop_to_border = True
    cropped = f12(tmp_path / "cropped.png")
    rows, columns = np.flatnonzero(inside.any(1)), np.flatnonzero(inside.any(0))
    np.testing.assert_array_equal(cropped, whole[rows[0] : rows[-1] + 1, columns[0] : columns[-1] + 1])


def test_a_transparent_film_keeps_the_colours(tmp_path, stage, bridge, gaussians, camera):
    stage.render.film_transparent = True
    half = gaussians.select(np.arange(0, gaussians.count, 20))
    obj = bridge.object_from_scene("half", half, stage.collection)
    expected, rendered = drawn(bridge, half, camera, obj.matrix_world, ("rgb", "alpha")), f12(tmp_path / "film.png")
    assert rendered[..., 3].min() < 0.1 and rendered[..., 3].max() > 0.9
    np.testing.assert_allclose(rendered[..., 3], expected["alpha"], atol=LEVEL)
    np.testing.assert_allclose(rendered[..., :3] * rendered[..., 3:], expected["rgb"], atol=1.5 * LEVEL)


def test_several_splats_are_one_picture(tmp_path, stage, bridge, gaussians, splat, camera):
    """The second one lies there by its matrix: turned, mirrored and stretched, as its Gaussians are turned the other way."""
    whole = f12(tmp_path / "whole.png")
    bpy.data.objects.remove(splat)
    away = Matrix.Rotation(1.1, 4, (1, 2, 3)) @ Matrix.Diagonal((-0.5, 2.0, 1.0, 1.0))
    degree0 = replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, :1]))
    parts = degree0.select(np.arange(1500)), gaussians.select(np.arange(1500, 3000))
    moved = part("svrgs_addon.geometry.affine").transformed(parts[0], np.array(away.inverted()))
    first = bridge.object_from_scene("first", moved, stage.collection, bridge.AXES @ away)
    bridge.object_from_scene("second", parts[1], stage.collection)
    both = part("svrgs_addon.geometry.merge").merged(parts)
    expected = drawn(bridge, both, camera, bridge.AXES)["rgb"]
    assert np.abs(f12(tmp_path / "two.png")[..., :3] - expected).max() <= 2 * LEVEL
    assert np.abs(expected - whole[..., :3]).max() > 0.05, "colours that depend on the direction count"
    first.hide_render = True
    expected = drawn(bridge, parts[1], camera, bridge.AXES)["rgb"]
    assert np.abs(f12(tmp_path / "one.png")[..., :3] - expected).max() <= LEVEL


@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_what_meshes_hide_is_hidden(tmp_path, stage, bridge, gaussians, splat, camera, kind):
    """A wall across the view: the Gaussians before it over its colour. Hidden for the render, it is not there."""
    camera.data.type = kind
    without = f12(tmp_path / "without.png")
    mesh = bpy.data.meshes.new("wall")
    mesh.from_pydata([(-99, -99, -3), (99, -99, -3), (99, 99, -3), (-99, 99, -3)], [], [(0, 1, 2, 3)])
    material = bpy.data.materials.new("red")
    if bpy.app.version < (5, 0, 0):
        material.use_nodes = True
    next(node for node in material.node_tree.nodes if node.type == "BSDF_PRINCIPLED").inputs["Base Color"].default_value = (1, 0, 0, 1)
    mesh.materials.append(material)
    wall = bpy.data.objects.new("wall", mesh)
    wall.matrix_world = camera.matrix_world
    stage.collection.objects.link(wall)
    bpy.context.view_layer.update()
    view = bridge.camera_from_object(camera, stage, bridge.render_size(stage)).moved(splat.matrix_world)
    before = gaussians.select(gaussians.means @ view.viewmat[2, :3] + view.viewmat[2, 3] <= 3)
    assert 100 < before.count < 2900
    expected = drawn(bridge, before, camera, splat.matrix_world, background=(1.0, 0.0, 0.0))["rgb"]
    assert np.abs(f12(tmp_path / "wall.png")[..., :3] - expected).max() <= LEVEL
    wall.hide_render = True
    np.testing.assert_array_equal(f12(tmp_path / "hidden.png"), without)


def test_passes_hold_what_the_rasterizer_counted(tmp_path, stage, bridge, gaussians, camera):
    """As they are handed to Blender: files of passes differ between versions."""
    engine_module = part("operators.render_engine")
    few = gaussians.select(np.arange(0, gaussians.count, 10))
    bridge.object_from_scene("few", few, stage.collection)
    seen = {}
    original = engine_module.SVRGS_engine.hand_in

    def keep(self, layers, width, height):
        seen.update(layers)
        original(self, layers, width, height)

    engine_module.SVRGS_engine.hand_in = keep
    try:
        f12(tmp_path / "passes.png")
    finally:
        engine_module.SVRGS_engine.hand_in = original
    expected = drawn(bridge, few, camera, bridge.AXES, ("depth", "alpha", "mask", "hits"), mask_kind="svr")
    np.testing.assert_allclose(seen["SpatialMask"], expected["mask"], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(seen["Count"], expected["hits"])
    np.testing.assert_allclose(seen["Alpha"], expected["alpha"], atol=1e-5)
    some = expected["alpha"] > 0.01
    np.testing.assert_allclose(seen["Depth"][some], (expected["depth"] / np.maximum(expected["alpha"], 1e-9))[some], rtol=1e-5)
    assert (seen["Depth"][expected["alpha"] == 0] == 1e10).all()


def test_passes_are_saved(tmp_path, stage, splat, camera):
    oiio = pytest.importorskip("OpenImageIO")
    settings = stage.render.image_settings
    if hasattr(settings, "media_type"):
        settings.media_type = "MULTI_LAYER_IMAGE"
    settings.file_format = "OPEN_EXR_MULTILAYER"
    try:
        stage.render.filepath = str(tmp_path / "passes.exr")
        bpy.ops.render.render(write_still=True)
    finally:
        if hasattr(settings, "media_type"):
            settings.media_type = "IMAGE"
    names, source, part_number = set(), oiio.ImageInput.open(str(tmp_path / "passes.exr")), 0
    while source.seek_subimage(part_number, 0):
        names |= {name.split(".", 1)[1] for name in source.spec().channelnames}
        part_number += 1
    assert names >= {"Combined.R", "Combined.A", "Depth.Z", "Alpha.A", "SpatialMask.X", "Count.X"}


def test_panoramas_are_refused_in_one_sentence(splat, camera):
    camera.data.type = "PANO"
    with pytest.raises(RuntimeError, match="neither perspective nor orthographic"):
        bpy.ops.render.render()


def test_an_object_that_is_no_camera_is_refused_in_one_sentence(stage, bridge, splat):
    """Blender takes any object as the scene's camera."""
    stage.camera = bpy.data.objects.new("nothing", None)
    stage.collection.objects.link(stage.camera)
    mark_removed(splat, np.arange(bridge.count(splat)) % 2)
    for ask in (bpy.ops.render.render, bpy.ops.svrgs.spatial_mask, bpy.ops.svrgs.compare, lambda: bpy.ops.svrgs.contribution(cameras="ACTIVE")):
        with pytest.raises(RuntimeError, match="'nothing' is no camera"):
            ask()


def test_a_picture_is_handed_in_whatever_happens(splat, camera, monkeypatch):
    engine, handed = part("operators.render_engine").SVRGS_engine, []
    hand_in = engine.hand_in

    def fail(*_):
        raise ValueError("nobody expects this")

    monkeypatch.setattr(engine, "picture", fail)
    monkeypatch.setattr(engine, "hand_in", lambda self, *rest: (handed.append(rest[1:]), hand_in(self, *rest)))
    with contextlib.suppress(RuntimeError):
        bpy.ops.render.render()
    assert handed == [(101, 61)]


def test_nothing_to_render_is_said(camera):
    with pytest.raises(RuntimeError, match="no splat to render"):
        bpy.ops.render.render()


def test_an_animation_follows_the_objects(tmp_path, stage, bridge, gaussians, splat, camera):
    for frame, z in ((1, 0.0), (2, 0.5)):
        splat.location.z = z
        splat.keyframe_insert("location", frame=frame)
    stage.frame_start, stage.frame_end, stage.render.filepath = 1, 2, str(tmp_path / "frame")
    bpy.ops.render.render(animation=True)
    for frame in (1, 2):
        stage.frame_set(frame)
        rendered = pixels(bpy.data.images.load(str(tmp_path / f"frame{frame:04}.png")))
        assert np.abs(rendered[..., :3] - drawn(bridge, gaussians, camera, splat.matrix_world)["rgb"]).max() <= LEVEL


def test_removed_gaussians_are_not_drawn(tmp_path, stage, bridge, gaussians, splat, camera):
    mark_removed(splat, np.arange(gaussians.count) % 2)
    expected = drawn(bridge, gaussians.select(np.arange(0, gaussians.count, 2)), camera, splat.matrix_world)["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_modifiers_count(tmp_path, stage, bridge, gaussians, splat, camera):
    """Geometry nodes that delete the later half of the points."""
    group = bpy.data.node_groups.new("half", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    kinds = "NodeGroupInput", "NodeGroupOutput", "GeometryNodeDeleteGeometry", "FunctionNodeCompare", "GeometryNodeInputIndex"
    into, out, delete, compare, index = (group.nodes.new(kind) for kind in kinds)
    compare.data_type, compare.operation = "INT", "GREATER_EQUAL"
    number, limit = (socket for socket in compare.inputs if socket.enabled)
    limit.default_value = gaussians.count // 2
    wires = (into, 0, delete.inputs[0]), (index, 0, number), (compare, 0, delete.inputs[1]), (delete, 0, out.inputs[0])
    for node, socket, to in wires:
        group.links.new(node.outputs[socket], to)
    splat.modifiers.new("half", "NODES").node_group = group
    expected = drawn(bridge, gaussians.select(np.arange(gaussians.count // 2)), camera, splat.matrix_world)["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_viewports_show_splats_of_instanced_collections_as_renders_do(stage, bridge, gaussians, splat):
    """Twice, one of them within another instance; not where what instances them is hidden."""
    graph = part("operators.bridge_graph")

    def instance(name: str, of, into, place):
        obj = bpy.data.objects.new(name, None)
        obj.instance_type, obj.instance_collection, obj.location = "COLLECTION", of, place
        into.objects.link(obj)
        return obj

    def places(found) -> list:
        bpy.context.view_layer.update()
        return sorted((obj.name, tuple(round(number, 4) for number in matrix.translation)) for obj, matrix in found())

    view = types.SimpleNamespace(view_layer=bpy.context.view_layer, space_data=None)
    in_view, in_render = lambda: graph.splats_in_view(view), lambda: graph.placed_splats(bpy.context.evaluated_depsgraph_get())
    inner, outer = bpy.data.collections.new("inner"), bpy.data.collections.new("outer")
    bridge.object_from_scene("copied", gaussians, inner)
    once, nested = instance("once", inner, stage.collection, (1, 0, 0)), instance("nested", outer, stage.collection, (0, 2, 0))
    instance("within", inner, outer, (0, 0, 3))
    own, first, second = ("room", (0, 0, 0)), ("copied", (1, 0, 0)), ("copied", (0, 2, 3))
    assert places(in_view) == places(in_render) == sorted([own, first, second])
    once.hide_set(True)
    assert places(in_view) == sorted([own, second])
    nested.hide_viewport = True
    assert places(in_view) == [own]


def mark_removed(obj, removed):
    obj.data.attributes.new("removed", "INT8", "POINT").data.foreach_set("value", removed.astype(np.int8))
    obj.data.update_tag()
    bpy.context.view_layer.update()


# --- images


def test_the_spatial_mask_is_an_image_and_a_texture(stage, bridge, gaussians, splat, camera):
    looking = stage.svrgs_looking
    looking.mask_size, looking.mask_colors, looking.mask_top = 101, "values", 0
    bpy.ops.svrgs.spatial_mask()
    image = bpy.data.images["SVR-GS Spatial Mask"]
    assert image.is_float and image.colorspace_settings.name == "Non-Color" and tuple(image.size) == (101, 61)
    assert bpy.data.textures["SVR-GS Spatial Mask"].image == image
    expected = drawn(bridge, gaussians, camera, splat.matrix_world, ("mask",), mask_kind="svr")["mask"]
    np.testing.assert_allclose(pixels(image)[..., 0], expected, atol=1e-3, rtol=1e-3)
    result = json.loads(looking.mask_result)
    assert result["camera"] == "camera" and math.isclose(result["largest"], expected.max(), rel_tol=1e-3)


def test_colours_of_the_mask_change_without_another_drawing(stage, splat, camera):
    looking = stage.svrgs_looking
    looking.mask_colors = "inferno"
    bpy.ops.svrgs.spatial_mask()
    image = bpy.data.images["SVR-GS Spatial Mask"]
    before = pixels(image).copy()
    looking.mask_colors = "viridis"
    assert bpy.data.images["SVR-GS Spatial Mask"] == image and np.abs(pixels(image) - before).max() > 0.1
    looking.mask_top = 1e9
    assert np.ptp(pixels(image)[..., :3], axis=(0, 1)).max() < 1e-3, "everything is near the lowest colour"
    looking.mask_top = 0


def test_the_mask_follows_edits(stage, bridge, gaussians, splat, camera):
    bpy.ops.svrgs.spatial_mask()
    before = json.loads(stage.svrgs_looking.mask_result)["mean"]
    mark_removed(splat, np.arange(gaussians.count) % 2)
    bpy.ops.svrgs.spatial_mask()
    assert json.loads(stage.svrgs_looking.mask_result)["mean"] < before


def test_the_mask_is_drawn_anew_only_when_something_has_moved(stage, splat, camera):
    mask_image = part("operators.mask_image")
    bpy.ops.svrgs.spatial_mask()
    assert not mask_image.is_stale(bpy.context)
    for move in (lambda: setattr(camera, "location", (0, -5, 1)), lambda: setattr(splat, "scale", (2, 2, 2)), lambda: setattr(splat, "hide_viewport", True)):
        move()
        bpy.context.view_layer.update()
        assert mask_image.is_stale(bpy.context)
        if not splat.hide_viewport:
            bpy.ops.svrgs.spatial_mask()
            assert not mask_image.is_stale(bpy.context)


def test_the_mask_is_drawn_anew_where_an_address_in_memory_is_used_again(bridge, gaussians, splat, camera, monkeypatch):
    mask_image = part("operators.mask_image")
    monkeypatch.setattr(mask_image, "id", lambda _: 0, raising=False)
    bpy.ops.svrgs.spatial_mask()
    mark_removed(splat, np.arange(gaussians.count) % 2)
    assert mask_image.is_stale(bpy.context)


def seen_number(obj) -> int:
    """Of what is kept of the splat for drawing."""
    return part("operators.scene_cache").number(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))


def test_gaussians_that_change_by_frame_are_read_anew_and_others_are_not(stage, bridge, gaussians, splat, camera):
    """Geometry nodes that move the points up with time."""
    still = bridge.object_from_scene("still", gaussians, stage.collection)
    group = bpy.data.node_groups.new("rising", "GeometryNodeTree")
    for side in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=side, socket_type="NodeSocketGeometry")
    kinds = "NodeGroupInput", "NodeGroupOutput", "GeometryNodeSetPosition", "ShaderNodeCombineXYZ", "GeometryNodeInputSceneTime"
    into, out, move, offset, time = (group.nodes.new(kind) for kind in kinds)
    wires = (
        (into.outputs[0], move.inputs[0]),
        (time.outputs["Frame"], offset.inputs[2]),
        (offset.outputs[0], move.inputs["Offset"]),
        (move.outputs[0], out.inputs[0]),
    )
    for socket, to in wires:
        group.links.new(socket, to)
    splat.modifiers.new("rising", "NODES").node_group = group
    stage.frame_set(1)
    before = seen_number(splat), seen_number(still)
    stage.frame_set(3)
    shown = part("operators.scene_cache").read(splat.evaluated_get(bpy.context.evaluated_depsgraph_get()))
    np.testing.assert_allclose(shown.means[:, 2].mean(), gaussians.means[:, 2].mean() + 3, atol=1e-4)
    assert seen_number(splat) != before[0] and seen_number(still) == before[1]


def test_nothing_is_kept_of_a_splat_that_is_gone(stage, bridge, gaussians, splat, camera):
    cache = part("operators.scene_cache")
    other = bridge.object_from_scene("other", gaussians, stage.collection)
    bpy.context.view_layer.update()
    cache._entries.clear()
    seen_number(splat), seen_number(other)
    bpy.data.objects.remove(other)
    bpy.context.view_layer.update()
    assert set(cache._entries) == {splat.session_uid}


def test_the_mask_follows_in_the_scene_that_changed(stage, bridge, gaussians, splat, camera):
    """Whichever scene is active when the time has come to draw."""
    follower = part("operators.spatial_mask")
    other = bpy.data.scenes.new("other")
    try:
        stage.svrgs_looking.mask_follow, other.svrgs_looking.mask_follow = False, True
        stage.svrgs_looking.mask_result = ""
        other.camera = bpy.data.objects.new("of the other", camera.data)
        for obj in (other.camera, splat):
            other.collection.objects.link(obj)
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            follower._after_change(other, bpy.context.evaluated_depsgraph_get())  # as Blender does for a scene in a window
        follower._follow()
        assert not stage.svrgs_looking.mask_result
        assert json.loads(other.svrgs_looking.mask_result)["camera"] == "of the other"
    finally:
        bpy.data.scenes.remove(other)
        stage.svrgs_looking.mask_follow = False


def test_contribution_is_the_score(stage, bridge, gaussians, splat, camera):
    bpy.ops.svrgs.contribution(cameras="ACTIVE")
    values = np.empty(gaussians.count, np.float32)
    splat.data.attributes["contribution"].data.foreach_get("value", values)
    native = part("svrgs_addon.native")
    view = bridge.camera_from_object(camera, stage, bridge.render_size(stage)).moved(splat.matrix_world)
    expected, _, _ = part("svrgs_addon.finetune.scores").contribution(gaussians, [view], native.Rasterizer(), native.RenderOptions())
    np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-3)


def test_only_splats_are_offered_for_comparing(stage, splat, camera):
    kinds = typing.get_type_hints(type(stage.svrgs_looking))  # as Blender reads them
    for name in ("original", "pruned"):
        offered = kinds[name].keywords["poll"]
        assert offered(stage.svrgs_looking, splat) and not offered(stage.svrgs_looking, camera)


def test_compare_draws_both_and_measures_against_the_photograph(tmp_path, stage, bridge, ply):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    scene = bridge.scene_from_object(splat)
    with pytest.raises(RuntimeError, match="nothing to compare"):
        bpy.ops.svrgs.compare()
    mark_removed(splat, np.arange(scene.count) % 3 == 0)
    bpy.ops.svrgs.compare()
    result = json.loads(stage.svrgs_looking.compare_result)
    assert result["original"]["count"] == scene.count and result["pruned"]["count"] == scene.count - len(range(0, scene.count, 3))
    ply.write_ply(tmp_path / "scene.ply", scene)
    assert result["original"]["bytes"] == (tmp_path / "scene.ply").stat().st_size
    original, pruned, difference = (pixels(bpy.data.images[f"SVR-GS {name}"])[..., :3] for name in ("Original", "Pruned", "Difference"))
    np.testing.assert_allclose(difference, np.minimum(4 * np.abs(original - pruned), 1), atol=3 * LEVEL)
    photo = pixels(bpy.data.images.load(str(DATA / f"tiny/images/{result['camera']}")))[..., :3]
    for picture, row in ((original, result["original"]), (pruned, result["pruned"])):
        assert math.isclose(row["psnr"], -10 * math.log10(np.mean((picture - photo) ** 2)), rel_tol=1e-3)
        assert 0 < row["ssim"] <= 1 and 0 <= row["flip"] < 1


def test_the_wipe_moves(stage, bridge, splat, camera):
    mark_removed(splat, np.arange(bridge.count(splat)) % 2)
    bpy.ops.svrgs.compare()
    original, pruned = (pixels(bpy.data.images[f"SVR-GS {name}"]) for name in ("Original", "Pruned"))
    for share in (0.0, 0.3, 1.0):
        stage.svrgs_looking.wipe = share
        wipe, edge = pixels(bpy.data.images["SVR-GS Wipe"]), round(share * 101)
        np.testing.assert_array_equal(wipe[:, :edge], original[:, :edge])
        np.testing.assert_array_equal(wipe[:, edge:], pruned[:, edge:])


def test_a_contact_sheet_of_all_cameras(stage, bridge):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    stage.svrgs_looking.pruned = splat
    bpy.ops.svrgs.contact_sheet()
    width, height = bpy.data.images["SVR-GS Contact Sheet"].size
    assert width == 2 * (3 * 64 + 2 * 4) + 12 and height == 6 * 48 + 5 * 4


# --- files


def test_settings_and_images_survive_a_file(tmp_path, stage, splat, camera):
    stage.svrgs_looking.wipe = 0.25
    bpy.ops.svrgs.spatial_mask()
    bpy.data.images["SVR-GS Spatial Mask"].pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    assert bpy.context.scene.svrgs_looking.wipe == 0.25 and bpy.context.scene.render.engine == "SVRGS"
    assert tuple(bpy.data.images["SVR-GS Spatial Mask"].size)[0] > 0
    bpy.ops.svrgs.spatial_mask()


@pytest.mark.parametrize("packed", [False, True])
def test_numbers_of_pictures_go_with_the_pictures(tmp_path, bridge, splat, camera, packed):
    """Blender saves a picture with the file only if it is packed."""
    mark_removed(splat, np.arange(bridge.count(splat)) % 2)
    bpy.ops.svrgs.compare()
    bpy.ops.svrgs.spatial_mask()
    if packed:
        for image in bpy.data.images:
            image.use_fake_user = True
            image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    looking = bpy.context.scene.svrgs_looking
    assert bool(looking.compare_result) == bool(looking.mask_result) == packed
    if packed:
        assert pixels(bpy.data.images["SVR-GS Wipe"])[..., :3].any()
