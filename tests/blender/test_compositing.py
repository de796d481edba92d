"""Set Up Rendering, Set Up Compositing, and what the compositor makes of meshes and splats."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import Layout
from mathutils import Matrix
from mesh_objects import shader_of, wall
from view_helpers import LEVEL, drawn, f12, view_of

pytestmark = pytest.mark.usefixtures("stage")
COLOR, GREEN = (0.3, 0.05, 0.6), (0.0, 0.5, 0.0)  # linear


def srgb(color) -> np.ndarray:
    """Opaque display sRGB (4,) of a linear colour."""
    return np.append(part("svrgs_addon.files.images").linear_to_srgb(np.float32(color)), np.float32(1))


@pytest.fixture
def cycles(stage):
    """A scene that Cycles renders with a transparent film, without light; afterwards no other scene is
    left."""
    stage.render.engine, stage.cycles.samples, stage.cycles.use_denoising = "CYCLES", 16, False
    stage.cycles.pixel_filter_type, stage.render.dither_intensity = "BOX", 0
    world = bpy.data.worlds.new("dark")
    if bpy.app.version < (5, 0, 0):
        world.use_nodes = True
    next(node for node in world.node_tree.nodes if node.type == "BACKGROUND").inputs[
        "Color"
    ].default_value = (0, 0, 0, 1)
    stage.world, stage.render.film_transparent = world, True
    yield stage
    for scene in list(bpy.data.scenes):
        if scene != stage:
            bpy.data.scenes.remove(scene)
    stage.render.film_transparent = stage.render.use_border = stage.render.use_crop_to_border = False
    if bpy.app.version >= (5, 0, 0):
        stage.compositing_node_group = None
        bpy.data.batch_remove(list(bpy.data.node_groups))
    else:
        if stage.node_tree is not None:
            stage.node_tree.nodes.clear()
        stage.use_nodes = False


def glow(obj, color=COLOR):
    """Makes a mesh shine in one colour, whatever the light is."""
    shader = shader_of(obj.data.materials[0])
    shader.inputs["Base Color"].default_value = (0, 0, 0, 1)
    shader.inputs["Specular IOR Level"].default_value = 0
    shader.inputs["Emission Color"].default_value = (*color, 1)
    shader.inputs["Emission Strength"].default_value = 1


def tree_of(scene):
    return scene.compositing_node_group if bpy.app.version >= (5, 0, 0) else scene.node_tree


def layer_of(scene):
    return part("operators.scene.splat_layer").layer_of(scene)


def over(front, behind):
    """Of pictures (H, W, 4), display sRGB times alpha."""
    return front + (1 - front[..., 3:]) * behind


def rgba(images) -> np.ndarray:
    """The rasterizer's picture: display sRGB times alpha."""
    return np.concatenate([images["rgb"], images["alpha"][..., None]], axis=2)


def rendered(path) -> np.ndarray:
    """F12 as display sRGB times alpha."""
    seen = f12(path)
    return np.concatenate([seen[..., :3] * seen[..., 3:], seen[..., 3:]], axis=2)


def raw(scene, camera, matrix) -> dict:
    """As drawn(), without rounding."""
    native, view = part("svrgs_addon.native.rasterizer"), view_of(camera, bpy.context.scene).moved(matrix)
    return native.Rasterizer().forward(scene, view, native.RenderOptions(), outputs=("rgb", "alpha"))


def parts(gaussians, stage, room, camera, depth):
    """The Gaussians before and behind a wall across the view."""
    view = view_of(camera, stage).moved(room.matrix_world)
    before = gaussians.means @ view.viewmat[2, :3] + view.viewmat[2, 3] <= depth
    return gaussians.select(np.flatnonzero(before)), gaussians.select(np.flatnonzero(~before))


# --- Set Up Rendering


def alone() -> bool:
    """Whether Blender's own engines draw no splats."""
    return not part("operators.data.splat_object").BLENDER_HAS_SPLATS


def test_one_click_sets_engine_colours_and_resolution(stage, tmp_path):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    size = stage.render.resolution_x, stage.render.resolution_y
    stage.render.engine, stage.render.resolution_x = "CYCLES", 17
    stage.view_settings.view_transform, stage.view_settings.exposure = "AgX", 1.0
    assert ("does not draw splats" in part("operators.scene.splat_layer").missing(stage)) == alone()
    assert bpy.ops.svrgs.set_up_rendering() == {"FINISHED"}
    assert (stage.render.engine, stage.view_settings.view_transform) == ("SVRGS", "Standard")
    assert stage.view_settings.exposure == 0
    assert (stage.render.resolution_x, stage.render.resolution_y) == size
    assert part("operators.scene.splat_layer").missing(stage) == ""
    words = part("operators.scene.set_up_rendering").camera_words(stage)
    assert f"'{stage.camera.name}'" in words and f"{size[0]} x {size[1]}" in words
    assert words.endswith("as its photograph")
    stage.camera = None
    assert "no camera" in part("operators.scene.set_up_rendering").camera_words(stage)


def test_the_panels_say_what_is_missing(stage, room):
    def drawn_panel(name):
        layout = Layout()
        cls = getattr(part("panels.rendering"), name)
        cls.draw(SimpleNamespace(layout=layout), bpy.context)
        return layout.text

    assert not part("panels.rendering").SVRGS_PT_not_drawn.poll(bpy.context)
    stage.render.engine = "BLENDER_WORKBENCH"
    stage.view_settings.view_transform = "Filmic" if bpy.app.version < (5, 0, 0) else "AgX"
    assert part("panels.rendering").SVRGS_PT_not_drawn.poll(bpy.context)
    for name in ("SVRGS_PT_rendering", "SVRGS_PT_not_drawn"):
        text = drawn_panel(name)
        assert ("Workbench does not draw splats" in text, "Workbench draws splats itself" in text) == (
            alone(),
            not alone(),
        )
        assert "svrgs.set_up_rendering" in text and "svrgs.set_up_compositing" in text
        assert "svrgs.use_standard" in text and "changes the colours of the training" in text
    bpy.ops.svrgs.use_standard()
    assert stage.view_settings.view_transform == "Standard"
    assert "svrgs.use_standard" not in drawn_panel("SVRGS_PT_rendering")
    bpy.data.objects.remove(room)
    assert part("operators.scene.splat_layer").missing(stage) == ""
    with pytest.raises(RuntimeError, match="no splat"):
        bpy.ops.svrgs.set_up_compositing()


# --- Set Up Compositing


def test_splats_and_meshes_are_put_together_by_depth(tmp_path, cycles, gaussians, room, camera):
    """A glowing wall: the Gaussians before it over its colour, those behind it hidden. Beside it all of
    them."""
    glow(wall(camera, 1.5))
    bpy.ops.svrgs.set_up_compositing()
    assert part("operators.scene.splat_layer").missing(cycles) == ""
    before, _ = parts(gaussians, cycles, room, camera, 1.5)
    front = rgba(raw(before, camera, room.matrix_world))
    np.testing.assert_allclose(
        rendered(tmp_path / "wall.png"), over(front, srgb(COLOR)).clip(0, 1), atol=1.5 * LEVEL
    )
    for obj in [obj for obj in bpy.data.objects if obj.name == "wall"]:
        bpy.data.objects.remove(obj)
    alone = rgba(raw(gaussians, camera, room.matrix_world))
    np.testing.assert_allclose(rendered(tmp_path / "alone.png"), alone.clip(0, 1), atol=1.5 * LEVEL)


def test_edges_of_meshes_have_no_fringe(tmp_path, cycles, gaussians, room, camera):
    """A tilted glowing square: each pixel is its share of the square and else the picture without it."""
    obj = wall(camera, 1.5, half=0.4)
    obj.matrix_world = camera.matrix_world @ Matrix.Rotation(0.3, 4, "Z")
    glow(obj)
    room.hide_render = True
    share = rendered(tmp_path / "square.png")[..., 3:]
    room.hide_render = False
    bpy.ops.svrgs.set_up_compositing()
    before, _ = parts(gaussians, cycles, room, camera, 1.5)
    front, whole = (rgba(raw(scene, camera, room.matrix_world)) for scene in (before, gaussians))
    expected = share * over(front, srgb(COLOR)) + (1 - share) * whole
    edge = (share[..., 0] > 0.1) & (share[..., 0] < 0.9) & (whole[..., 3] > 0.98)
    differs = np.abs(rendered(tmp_path / "edge.png") - expected)
    assert edge.sum() > 40 and differs[edge].mean() < 0.02 and differs[edge].max() < 0.15


def test_a_film_that_was_opaque_has_the_background_behind_all(tmp_path, cycles, bridge, gaussians, camera):
    few = gaussians.select(np.arange(0, gaussians.count, 20))
    half = bridge.object_from_scene("half", few, cycles.collection)
    cycles.render.film_transparent, cycles.svrgs_view.background = False, (0.2, 0.4, 0.6)
    bpy.ops.svrgs.set_up_compositing()
    assert cycles.render.film_transparent
    background = tuple(cycles.svrgs_view.background)
    expected = rgba(raw(few, camera, half.matrix_world))
    np.testing.assert_allclose(
        rendered(tmp_path / "f12.png"),
        over(expected, np.float32((*background, 1))).clip(0, 1),
        atol=1.5 * LEVEL,
    )
    bpy.ops.svrgs.set_up_rendering()
    assert not cycles.render.film_transparent


def test_with_an_opaque_film_the_world_is_behind_the_splats(
    tmp_path, cycles, bridge, gaussians, room, camera
):
    next(node for node in cycles.world.node_tree.nodes if node.type == "BACKGROUND").inputs[
        "Color"
    ].default_value = (*GREEN, 1)
    half = bridge.object_from_scene(
        "half", gaussians.select(np.arange(0, gaussians.count, 20)), cycles.collection
    )
    bpy.data.objects.remove(room)
    glow(wall(camera, 1.5, half=0.3))
    half.hide_render = True
    share = rendered(tmp_path / "wall.png")[..., 3:]
    half.hide_render = False
    bpy.ops.svrgs.set_up_compositing()
    cycles.render.film_transparent = False
    seen = rendered(tmp_path / "opaque.png")
    few = gaussians.select(np.arange(0, gaussians.count, 20))
    view = view_of(camera, cycles).moved(half.matrix_world)
    before = few.select(np.flatnonzero(few.means @ view.viewmat[2, :3] + view.viewmat[2, 3] <= 1.5))
    for scene, behind, inside in (
        (few, srgb(GREEN), share[..., 0] == 0),
        (before, srgb(COLOR), share[..., 0] == 1),
    ):
        picture = rgba(raw(scene, camera, half.matrix_world))
        assert inside.sum() > 500
        np.testing.assert_allclose(seen[inside], over(picture, behind).clip(0, 1)[inside], atol=2 * LEVEL)


def test_a_holdout_is_a_hole_in_the_whole_picture(tmp_path, cycles, gaussians, room, camera):
    wall(camera, 1.5).is_holdout = True
    bpy.ops.svrgs.set_up_compositing()
    before, _ = parts(gaussians, cycles, room, camera, 1.5)
    expected = raw(before, camera, room.matrix_world)["alpha"]
    np.testing.assert_allclose(f12(tmp_path / "holdout.png")[..., 3], expected, atol=1.5 * LEVEL)


def test_meshes_cast_shadows_on_splats_through_a_shadow_catcher(tmp_path, cycles, bridge, gaussians, camera):
    """A floor of Gaussians around the catcher, a ball above it, and light from above: the floor is darker
    under the ball."""
    flat = gaussians.select(np.arange(2500))
    rng = np.random.default_rng(0)
    means = np.stack([rng.uniform(-2, 2, 2500), np.full(2500, 0.05), rng.uniform(-2, 2, 2500)], 1).astype(
        np.float32
    )
    grey = np.full((2500, 1, 3), 0.9, np.float32)
    scene = type(flat)(
        means, np.full((2500, 3), -2.5, np.float32), flat.quats, np.full(2500, 4, np.float32), grey
    )
    bridge.object_from_scene("floor", scene, cycles.collection)
    camera.data.shift_x = camera.data.shift_y = 0
    camera.matrix_world = Matrix.Translation((0, -4, 3)) @ Matrix.Rotation(0.93, 4, "X")
    bpy.ops.mesh.primitive_plane_add(size=20)
    bpy.context.object.is_shadow_catcher = True
    bpy.ops.mesh.primitive_uv_sphere_add(radius=0.6, location=(0, 0, 2.2))
    ball = bpy.context.object
    bpy.ops.object.light_add(type="SUN", location=(0, 0, 9))
    bpy.context.object.data.energy = 3
    bpy.ops.svrgs.set_up_compositing()
    shadow = f12(tmp_path / "shadow.png")
    ball.hide_render = True
    light = f12(tmp_path / "light.png")
    rows, columns = slice(28, 34), slice(47, 54)  # the middle of the picture; the ball is above it
    assert shadow[rows, columns, :3].mean() < 0.6 * light[rows, columns, :3].mean()
    corner = slice(50, 60), slice(0, 15)
    np.testing.assert_allclose(shadow[corner], light[corner], atol=0.05)


def test_camera_size_and_border_are_those_of_the_scene(tmp_path, cycles, gaussians, room, camera):
    bpy.ops.svrgs.set_up_compositing()
    layer, other = layer_of(cycles), bpy.data.objects.new("other", camera.data)
    cycles.collection.objects.link(other)
    other.matrix_world = camera.matrix_world @ Matrix.Rotation(0.4, 4, "Y")
    cycles.camera, cycles.render.resolution_x, cycles.render.resolution_percentage = other, 120, 50
    bpy.context.view_layer.update()
    seen = rendered(tmp_path / "other.png")
    expected = rgba(raw(gaussians, other, room.matrix_world))
    assert seen.shape == (30, 60, 4)
    np.testing.assert_allclose(seen, expected.clip(0, 1), atol=1.5 * LEVEL)
    cycles.render.use_border = cycles.render.use_crop_to_border = True
    rows, columns = part("operators.view.render_engine").region(cycles)
    np.testing.assert_allclose(
        rendered(tmp_path / "border.png"), expected[rows, columns].clip(0, 1), atol=1.5 * LEVEL
    )
    assert layer.camera == other and layer.render.resolution_percentage == 50


def test_later_splats_and_meshes_are_in_the_picture(tmp_path, cycles, bridge, gaussians, room, camera):
    bpy.ops.svrgs.set_up_compositing()
    without = f12(tmp_path / "without.png")
    bridge.object_from_scene(
        "later", gaussians, cycles.collection, bridge.AXES @ Matrix.Translation((0.3, 0.2, 0))
    )
    assert "'later' as grey dots" in part("operators.scene.splat_layer").missing(cycles)
    bpy.ops.svrgs.set_up_compositing()
    assert part("operators.scene.splat_layer").missing(cycles) == ""
    assert np.abs(f12(tmp_path / "later.png") - without).mean() > 0.01


def test_a_second_click_changes_nothing(cycles, room, camera):
    bpy.ops.svrgs.set_up_compositing()
    tree = tree_of(cycles)
    wires = lambda: sorted(
        (link.from_node.name, link.from_socket.name, link.to_node.name, link.to_socket.name)
        for link in tree.links
    )
    once = len(bpy.data.scenes), len(tree.nodes), wires()
    bpy.ops.svrgs.set_up_compositing()
    assert (len(bpy.data.scenes), len(tree.nodes), wires()) == once
    tree.nodes["SVR-GS Splats"].mute = True
    tree.nodes.remove(tree.nodes["SVR-GS Around Render"])
    assert "not complete" in part("operators.scene.splat_layer").missing(cycles)
    bpy.ops.svrgs.set_up_compositing()
    assert (len(bpy.data.scenes), len(tree.nodes), wires()) == once
    assert part("operators.scene.splat_layer").missing(cycles) == ""


def test_nodes_of_the_user_stay_and_get_the_whole_picture(tmp_path, cycles, room, camera):
    """A Flip node between render and output: it gets the whole picture."""
    bpy.ops.svrgs.set_up_compositing()
    tree = tree_of(cycles)
    part("operators.scene.compositor_nodes").remove(cycles)
    render = next(node for node in tree.nodes if node.type == "R_LAYERS")
    users = render.outputs["Image"].links
    assert len(users) == 1 and len(tree.nodes) == 2, "as if it had never been set up"
    output, flip = users[0].to_node, tree.nodes.new("CompositorNodeFlip")
    if "Flip X" in flip.inputs:
        flip.inputs["Flip X"].default_value = True
    tree.links.new(render.outputs["Image"], flip.inputs["Image"])
    tree.links.new(flip.outputs[0], output.inputs[0])
    bpy.ops.svrgs.set_up_compositing()
    mirrored = f12(tmp_path / "mirrored.png")
    tree.links.new(tree.nodes["SVR-GS Around Render"].outputs[0], output.inputs[0])
    plain = f12(tmp_path / "plain.png")
    np.testing.assert_allclose(mirrored, plain[:, ::-1], atol=LEVEL)
    assert np.abs(mirrored - plain).max() > 0.2


def test_set_up_rendering_takes_the_compositing_away(tmp_path, cycles, gaussians, room, camera):
    bpy.ops.svrgs.set_up_compositing()
    assert not room.visible_camera
    bpy.ops.svrgs.set_up_rendering()
    cycles.render.film_transparent = False
    assert len(bpy.data.scenes) == 1 and room.visible_camera
    expected = drawn(gaussians, camera, room.matrix_world)["rgb"]
    assert np.abs(f12(tmp_path / "f12.png")[..., :3] - expected).max() <= LEVEL


def test_the_layers_own_scene_refuses_the_buttons(cycles, room, camera):
    bpy.ops.svrgs.set_up_compositing()
    layer = layer_of(cycles)
    with bpy.context.temp_override(scene=layer, view_layer=layer.view_layers[0]):
        for ask in (bpy.ops.svrgs.set_up_rendering, bpy.ops.svrgs.set_up_compositing):
            assert not ask.poll()
    assert part("operators.scene.splat_layer").missing(layer) == ""


def test_from_the_engine_svr_gs_it_goes_to_eevee(stage, room, camera, cycles):
    stage.render.engine = "SVRGS"
    bpy.ops.svrgs.set_up_compositing()
    assert stage.render.engine == part("operators.scene.set_up_rendering").EEVEE
    assert stage.render.film_transparent
