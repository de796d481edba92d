"""The render engine against `svrgs render` and the rasterizer."""

from __future__ import annotations

import contextlib
import types
from dataclasses import replace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from mathutils import Matrix
from view_helpers import LEVEL, add_geometry_nodes, drawn, f12, mark_removed, pixels

pytestmark = pytest.mark.usefixtures("stage")


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


@pytest.mark.parametrize(
    "change", ["plain", "percentage", "aspect", "portrait", "background", "scaled", "orthographic"]
)
def test_f12_is_the_rasterizers_picture(tmp_path, stage, gaussians, room, camera, change):
    background = (0.0, 0.0, 0.0)
    if change == "percentage":
        stage.render.resolution_percentage = 53
    elif change == "aspect":
        stage.render.pixel_aspect_x, camera.data.sensor_fit = 1.3, "VERTICAL"
    elif change == "portrait":
        stage.render.resolution_x, stage.render.resolution_y = 61, 101
    elif change == "background":
        background = stage.svrgs_view.background = (0.25, 0.5, 0.75)
    elif change == "orthographic":
        stage.render.pixel_aspect_x, camera.data.type, camera.data.ortho_scale = 1.3, "ORTHO", 4.0
        room.matrix_world = room.matrix_world @ Matrix.Scale(0.7, 4)
    elif change == "scaled":
        room.matrix_world = (
            Matrix.Translation((0, 1, 0))
            @ Matrix.Rotation(0.4, 4, "Z")
            @ room.matrix_world
            @ Matrix.Scale(0.7, 4)
        )
    expected = drawn(gaussians, camera, room.matrix_world, background=tuple(background))["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_dither_stays_as_it_was(tmp_path, stage, room, camera):
    stage.render.dither_intensity = 0.75
    f12(tmp_path / "f12.png")
    assert stage.render.dither_intensity == 0.75
    camera.data.type = "PANO"
    with pytest.raises(RuntimeError):
        bpy.ops.render.render()
    assert stage.render.dither_intensity == 0.75


def test_a_border_shows_the_same_pixels(tmp_path, stage, room, camera):
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
    expected, rendered = drawn(half, camera, obj.matrix_world, ("rgb", "alpha")), f12(tmp_path / "film.png")
    assert rendered[..., 3].min() < 0.1 and rendered[..., 3].max() > 0.9
    np.testing.assert_allclose(rendered[..., 3], expected["alpha"], atol=LEVEL)
    np.testing.assert_allclose(rendered[..., :3] * rendered[..., 3:], expected["rgb"], atol=1.5 * LEVEL)


def test_several_splats_are_one_picture(tmp_path, stage, bridge, gaussians, room, camera):
    """The second one lies there by its matrix: turned, mirrored and stretched, as its Gaussians are turned
    the other way."""
    whole = f12(tmp_path / "whole.png")
    bpy.data.objects.remove(room)
    away = Matrix.Rotation(1.1, 4, (1, 2, 3)) @ Matrix.Diagonal((-0.5, 2.0, 1.0, 1.0))
    degree0 = replace(gaussians, sh=np.ascontiguousarray(gaussians.sh[:, :1]))
    parts = degree0.select(np.arange(1500)), gaussians.select(np.arange(1500, 3000))
    moved = part("svrgs_addon.scene.affine").transformed(parts[0], np.array(away.inverted()))
    first = bridge.object_from_scene("first", moved, stage.collection, bridge.AXES @ away)
    bridge.object_from_scene("second", parts[1], stage.collection)
    both = part("svrgs_addon.scene.concatenate").concatenated(parts)
    expected = drawn(both, camera, bridge.AXES)["rgb"]
    assert np.abs(f12(tmp_path / "two.png")[..., :3] - expected).max() <= 2 * LEVEL
    assert np.abs(expected - whole[..., :3]).max() > 0.05, "colours that depend on the direction count"
    first.hide_render = True
    expected = drawn(parts[1], camera, bridge.AXES)["rgb"]
    assert np.abs(f12(tmp_path / "one.png")[..., :3] - expected).max() <= LEVEL


def test_passes_hold_what_the_rasterizer_counted(tmp_path, stage, bridge, gaussians, camera):
    """As they are handed to Blender: files of passes differ between versions."""
    engine_module = part("operators.view.render_engine")
    few = gaussians.select(np.arange(0, gaussians.count, 10))
    bridge.object_from_scene("few", few, stage.collection)
    seen = {}
    original = engine_module.SVRGS_engine.hand_in

    def keep(self, layers, *rest):
        seen.update(layers)
        original(self, layers, *rest)

    engine_module.SVRGS_engine.hand_in = keep
    try:
        f12(tmp_path / "passes.png")
    finally:
        engine_module.SVRGS_engine.hand_in = original
    expected = drawn(few, camera, bridge.AXES, ("depth", "alpha", "mask", "hits"), mask_kind="svr")
    np.testing.assert_allclose(seen["SpatialMask"], expected["mask"], rtol=1e-5, atol=1e-5)
    np.testing.assert_array_equal(seen["Count"], expected["hits"])
    np.testing.assert_allclose(seen["SplatAlpha"], expected["alpha"], atol=1e-5)
    some = expected["alpha"] > 0.01
    np.testing.assert_allclose(
        seen["Depth"][some], (expected["depth"] / np.maximum(expected["alpha"], 1e-9))[some], rtol=1e-5
    )
    assert (seen["Depth"][expected["alpha"] == 0] == 1e10).all()


def test_passes_are_saved(tmp_path, stage, room, camera):
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
    assert names >= {"Combined.R", "Combined.A", "Depth.Z", "SplatAlpha.A", "SpatialMask.X", "Count.X"}


def test_an_object_that_is_no_camera_is_refused_in_one_sentence(stage, bridge, room):
    """Blender takes any object as the scene's camera."""
    stage.camera = bpy.data.objects.new("nothing", None)
    stage.collection.objects.link(stage.camera)
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    for ask in (
        bpy.ops.render.render,
        bpy.ops.svrgs.spatial_mask,
        bpy.ops.svrgs.compare,
        lambda: bpy.ops.svrgs.contribution(cameras="ACTIVE"),
    ):
        with pytest.raises(RuntimeError, match="'nothing' is no camera"):
            ask()


def test_a_picture_is_handed_in_whatever_happens(room, camera, monkeypatch):
    engine, handed = part("operators.view.render_engine").SVRGS_engine, []
    hand_in = engine.hand_in

    def fail(*_):
        raise ValueError("nobody expects this")

    monkeypatch.setattr(engine, "picture", fail)
    monkeypatch.setattr(
        engine, "hand_in", lambda self, *rest: (handed.append(rest[1:]), hand_in(self, *rest))
    )
    with contextlib.suppress(RuntimeError):
        bpy.ops.render.render()
    assert handed == [(101, 61, "ViewLayer")]


def test_nothing_to_render_is_said(camera):
    with pytest.raises(RuntimeError, match="no splat to render"):
        bpy.ops.render.render()


def test_an_animation_follows_the_objects(tmp_path, stage, gaussians, room, camera):
    for frame, z in ((1, 0.0), (2, 0.5)):
        room.location.z = z
        room.keyframe_insert("location", frame=frame)
    stage.frame_start, stage.frame_end, stage.render.filepath = 1, 2, str(tmp_path / "frame")
    bpy.ops.render.render(animation=True)
    for frame in (1, 2):
        stage.frame_set(frame)
        rendered = pixels(bpy.data.images.load(str(tmp_path / f"frame{frame:04}.png")))
        assert np.abs(rendered[..., :3] - drawn(gaussians, camera, room.matrix_world)["rgb"]).max() <= LEVEL


def test_removed_gaussians_are_not_drawn(tmp_path, stage, gaussians, room, camera):
    mark_removed(room, np.arange(gaussians.count) % 2)
    expected = drawn(gaussians.select(np.arange(0, gaussians.count, 2)), camera, room.matrix_world)["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_modifiers_count(tmp_path, stage, gaussians, room, camera):
    """Geometry nodes that delete the later half of the points."""

    def half(group, geometry):
        index, compare = map(group.nodes.new, ("GeometryNodeInputIndex", "FunctionNodeCompare"))
        compare.data_type, compare.operation = "INT", "GREATER_EQUAL"
        number, limit = (socket for socket in compare.inputs if socket.enabled)
        limit.default_value = gaussians.count // 2
        group.links.new(index.outputs[0], number)
        delete = group.nodes.new("GeometryNodeDeleteGeometry")
        group.links.new(geometry, delete.inputs[0])
        group.links.new(compare.outputs[0], delete.inputs[1])
        return delete.outputs[0]

    add_geometry_nodes(room, half)
    expected = drawn(gaussians.select(np.arange(gaussians.count // 2)), camera, room.matrix_world)["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_viewports_show_splats_of_instanced_collections_as_renders_do(stage, bridge, gaussians, room):
    """Twice, one of them within another instance; not where what instances them is hidden."""
    graph = part("operators.data.visible_splats")

    def instance(name: str, of, into, place):
        obj = bpy.data.objects.new(name, None)
        obj.instance_type, obj.instance_collection, obj.location = "COLLECTION", of, place
        into.objects.link(obj)
        return obj

    def places(found) -> list:
        bpy.context.view_layer.update()
        return sorted(
            (obj.name, tuple(round(number, 4) for number in matrix.translation)) for obj, matrix in found()
        )

    view = types.SimpleNamespace(view_layer=bpy.context.view_layer, space_data=None)
    in_view = lambda: graph.splats_in_view(view)
    in_render = lambda: graph.placed_splats(bpy.context.evaluated_depsgraph_get())
    inner, outer = bpy.data.collections.new("inner"), bpy.data.collections.new("outer")
    bridge.object_from_scene("copied", gaussians, inner)
    once = instance("once", inner, stage.collection, (1, 0, 0))
    nested = instance("nested", outer, stage.collection, (0, 2, 0))
    instance("within", inner, outer, (0, 0, 3))
    own, first, second = ("room", (0, 0, 0)), ("copied", (1, 0, 0)), ("copied", (0, 2, 3))
    assert places(in_view) == places(in_render) == sorted([own, first, second])
    once.hide_set(True)
    assert places(in_view) == sorted([own, second])
    nested.hide_viewport = True
    assert places(in_view) == [own]


def test_an_object_in_front_counts_while_it_is_shown(stage, room):
    shows, view = part("operators.view.viewport").shows_in_front, types.SimpleNamespace(space_data=None)
    view.view_layer = bpy.context.view_layer
    assert not shows(view)
    room.show_in_front = True
    try:
        assert shows(view)
        room.hide_set(True)
        assert not shows(view)
    finally:
        room.show_in_front = False
        room.hide_set(False)


def test_a_file_that_is_saved_during_a_render_holds_the_dither_of_its_scene(stage, room, camera, tmp_path):
    save = lambda *_: bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "saved.blend"), copy=True)
    bpy.app.handlers.render_pre.append(save)
    try:
        f12(tmp_path / "f12.png")
    finally:
        bpy.app.handlers.render_pre.remove(save)
    with bpy.data.libraries.load(str(tmp_path / "saved.blend")) as (_, wanted):
        wanted.scenes = [stage.name]
    assert wanted.scenes[0].render.dither_intensity == stage.render.dither_intensity == 1
    bpy.data.scenes.remove(wanted.scenes[0])


def test_a_view_layer_leaves_out_what_is_indirect_only_and_says_what_no_splat_can_be(
    tmp_path, stage, room, camera, capfd
):
    collection = bpy.data.collections.new("splats")
    stage.collection.children.link(collection)
    stage.collection.objects.unlink(room)
    collection.objects.link(room)
    own = stage.view_layers[0].layer_collection.children["splats"]
    own.holdout = True
    assert (
        f12(tmp_path / "holdout.png")[..., :3].any()
        and "'room' is set as a holdout" in capfd.readouterr().out
    )
    own.holdout, own.indirect_only = False, True
    with pytest.raises(RuntimeError, match="there is no splat to render"):
        f12(tmp_path / "never.png")
    other = stage.view_layers.new("other")
    try:
        assert not f12(tmp_path / "first.png")[..., :3].any(), "the splats are in the other layer"
    finally:
        stage.view_layers.remove(other)


def test_it_is_said_that_there_is_no_splat_at_all_with_two_view_layers_too(tmp_path, stage, camera):
    other = stage.view_layers.new("other")
    try:
        with pytest.raises(RuntimeError, match="there is no splat to render"):
            f12(tmp_path / "f12.png")
    finally:
        stage.view_layers.remove(other)


def test_an_animation_goes_on_where_no_splat_is_shown(tmp_path, stage, room, camera, capfd):
    for frame, hidden in ((1, False), (2, True), (3, False)):
        room.hide_render = hidden
        room.keyframe_insert("hide_render", frame=frame)
    stage.frame_start, stage.frame_end, stage.render.filepath = 1, 3, str(tmp_path / "frame")
    bpy.ops.render.render(animation=True)
    shown = [
        pixels(bpy.data.images.load(str(tmp_path / f"frame000{frame}.png")))[..., :3].any()
        for frame in (1, 2, 3)
    ]
    assert shown == [True, False, True] and "no splat is shown in frame 2" in capfd.readouterr().out
