"""Equirectangular cameras in the render engine, against Cycles."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from extension import part
from mathutils import Matrix, Vector
from mesh_objects import material
from view_helpers import f12

from svrgs_bench import scenes

pytestmark = pytest.mark.usefixtures("stage")
SPOTS = {
    (0, 3, 0): (1, 0, 0),
    (3, 0.5, 0): (0, 1, 0),
    (0, 0.4, 3): (0, 0, 1),
    (1, 2, -1): (1, 1, 0),
    (-2, -1, 0.5): (0, 1, 1),
}


@pytest.fixture
def panorama(stage, camera):
    stage.render.resolution_x, stage.render.resolution_y = 180, 96
    camera.data.type, camera.data.panorama_type = "PANO", "EQUIRECTANGULAR"
    camera.data.shift_x = camera.data.shift_y = 0
    camera.location, camera.rotation_euler = (0.1, 0.2, 0.3), (1.3, 0.2, 0.4)
    bpy.context.view_layer.update()
    return camera


@pytest.fixture
def spots(stage, bridge, gaussians):
    """Small glowing balls around the camera, and a splat that is far away."""
    for place, color in SPOTS.items():
        bpy.ops.mesh.primitive_uv_sphere_add(radius=0.15, location=place)
        paint = material("glow", color)
        tree = paint.node_tree
        glow = tree.nodes.new("ShaderNodeEmission")
        glow.inputs["Color"].default_value = (*color, 1)
        tree.links.new(glow.outputs[0], tree.get_output_node("ALL").inputs["Surface"])
        bpy.context.object.data.materials.append(paint)
    bridge.object_from_scene(
        "far",
        gaussians.select(np.arange(1)),
        stage.collection,
        Matrix.Translation((0, -999, 0)) @ Matrix.Scale(1e-3, 4),
    )


def middles(picture: np.ndarray) -> dict:
    """Middle (column, row) of each spot that is whole in a picture."""
    found = {}
    for color in SPOTS.values():
        lit, dark = (
            picture[..., :3][..., [k for k in range(3) if bool(color[k]) == wanted]]
            for wanted in (True, False)
        )
        rows, columns = np.nonzero((lit > 0.35).all(axis=2) & (dark < 0.2).all(axis=2))
        if (
            len(rows)
            and 0 < rows.min()
            and rows.max() < picture.shape[0] - 1
            and 0 < columns.min()
            and columns.max() < picture.shape[1] - 1
        ):
            found[color] = columns.mean(), rows.mean()
    return found


@pytest.mark.parametrize("change", ["full", "limits", "shift"])
def test_what_cycles_shows_is_at_the_same_place(tmp_path, stage, panorama, spots, change):
    data = panorama.data
    if change == "limits":
        data.longitude_min, data.longitude_max, data.latitude_min, data.latitude_max = -1.0, 1.9, -0.5, 1.2
    elif change == "shift":
        data.shift_x, data.latitude_min, data.latitude_max, data.shift_y = 0.2, -1.0, 1.0, 0.1
    else:
        data.longitude_min, data.longitude_max, data.latitude_min = -math.pi, math.pi, -math.pi / 2
        data.latitude_max = math.pi / 2
    ours = middles(f12(tmp_path / "ours.png"))
    stage.render.engine, stage.cycles.samples, stage.cycles.use_denoising = "CYCLES", 4, False
    cycles = middles(f12(tmp_path / "cycles.png"))
    assert ours.keys() == cycles.keys() and len(ours) >= (2 if change == "limits" else 3)
    for color, place in ours.items():
        assert math.dist(place, cycles[color]) < 0.7, (color, place, cycles[color])


def test_a_splat_is_where_its_gaussians_are(tmp_path, stage, bridge, panorama):
    """Some small white Gaussians around the camera."""
    scene = scenes.room(5)
    means = np.array([[3, 0, 0.5], [-1, 2, 1], [0, -2, -2], [1, 1, 3], [-3, -1, -1]], np.float32)
    white = np.full((5, 1, 3), 1.7, np.float32)
    scene = type(scene)(
        means, np.full((5, 3), -2.7, np.float32), scene.quats, np.full(5, 5, np.float32), white
    )
    bridge.object_from_scene(
        "white", scene, stage.collection, Matrix.Rotation(0.3, 4, "X") @ Matrix.Scale(1.3, 4)
    )
    seen = f12(tmp_path / "white.png")[..., 0]
    inverse = panorama.matrix_world.inverted()
    for mean in means:
        x, y, z = inverse @ (Matrix.Rotation(0.3, 4, "X") @ Matrix.Scale(1.3, 4) @ Vector(mean))
        column = (math.atan2(x, -z) / (2 * math.pi) + 0.5) * 180
        row = (0.5 - math.asin(y / math.sqrt(x * x + y * y + z * z)) / math.pi) * 96
        around = seen[max(int(row) - 4, 0) : int(row) + 5, max(int(column) - 4, 0) : int(column) + 5]
        top, left = np.unravel_index(around.argmax(), around.shape)
        place = max(int(column) - 4, 0) + left + 0.5, max(int(row) - 4, 0) + top + 0.5
        assert around.max() > 0.7 and math.dist(place, (column, row)) < 2.5


def test_depths_are_distances(tmp_path, stage, bridge, gaussians, panorama, monkeypatch):
    """A ball around the camera, as Cycles' Depth pass has it."""
    bpy.ops.mesh.primitive_uv_sphere_add(segments=96, ring_count=48, radius=4, location=panorama.location)
    bridge.object_from_scene(
        "far", gaussians.select(np.arange(1)), stage.collection, Matrix.Translation((0, -999, 0))
    )
    engine, seen = part("operators.view.render_engine").SVRGS_engine, {}
    hand_in = engine.hand_in
    monkeypatch.setattr(
        engine, "hand_in", lambda self, layers, *size: (seen.update(layers), hand_in(self, layers, *size))
    )
    f12(tmp_path / "ball.png")
    np.testing.assert_allclose(seen["Depth"], 4, rtol=0.01)


def test_a_border_shows_the_same_pixels(tmp_path, stage, room, panorama):
    whole = f12(tmp_path / "whole.png")
    stage.render.use_border = stage.render.use_crop_to_border = True
    part_ = f12(tmp_path / "part.png")
    rows, columns = part("operators.view.render_engine").region(stage)
    np.testing.assert_array_equal(part_, whole[rows, columns])


def test_other_panoramas_are_refused_in_one_sentence(room, panorama):
    data = panorama.data
    for change, sentence in (
        (
            {"panorama_type": "FISHEYE_EQUIDISTANT"},
            "type Fisheye Equidistant: choose the type Equirectangular",
        ),
        ({"panorama_type": "EQUIRECTANGULAR", "latitude_max": 1.0, "shift_y": 0.4}, "beyond a pole"),
        ({"shift_y": 0.0, "longitude_min": 1.0, "longitude_max": 1.0}, "sees nothing"),
    ):
        for name, value in change.items():
            setattr(data, name, value)
        with pytest.raises(RuntimeError, match=sentence):
            bpy.ops.render.render()


def test_its_panel_shows_the_limits(panorama):
    from types import SimpleNamespace

    from job_helpers import Layout

    panel = part("panels.panorama").SVRGS_PT_panorama
    context = SimpleNamespace(engine="SVRGS", camera=panorama.data)
    assert panel.poll(context) and not panel.poll(SimpleNamespace(engine="CYCLES", camera=panorama.data))
    for kind, word in (("EQUIRECTANGULAR", "latitude_min"), ("FISHEYE_EQUIDISTANT", "Equirectangular only")):
        panorama.data.panorama_type, layout = kind, Layout()
        panel.draw(SimpleNamespace(layout=layout), context)
        assert word in layout.text
