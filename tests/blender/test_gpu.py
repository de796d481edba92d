"""Quads on the graphics card against the rasterizer, where Blender draws without a window (5.2 on)."""

from __future__ import annotations

import ctypes
import ctypes.util
from dataclasses import replace

import gpu
import numpy as np
import pytest
from extension import part
from mathutils import Matrix

from svrgs_bench import scenes

SIDE = 64


@pytest.fixture(scope="module")
def shaders():
    if not hasattr(gpu, "init") or not ctypes.util.find_library("EGL"):
        pytest.skip(
            "this Blender does not draw with the graphics card in background mode, or libEGL is missing"
        )
    gpu.init()
    return part("operators.data.gpu_drawing").Shaders()


def quads_picture(shaders, scene, camera, hidden=1.0, reduction: int = 1) -> np.ndarray:
    """(H, W, 4) of all Gaussians, from the top; hidden: depth in [0, 1] of what is in front, a number or (H,
    W)."""
    bridge_gpu, native, quads = (
        part("operators.data.gpu_drawing"),
        part("svrgs_addon.native.pictures"),
        part("svrgs_addon.render.quads"),
    )
    cloud = quads.quads(scene, scene.count)
    lists = {
        "order": bridge_gpu.texture(native.depth_order(cloud.means, camera.viewmat[2, :3]), "R32F"),
        "geometry": bridge_gpu.texture(cloud.geometry.reshape(-1, 4), "RGBA32F"),
        "colors": bridge_gpu.texture(quads.colors(scene, cloud.rows, camera), "RGBA16F"),
    }
    flip = np.diag([1.0, -1, -1, 1])
    small = camera.resized(camera.width // reduction, camera.height // reduction)
    near, far = part("svrgs_addon.native.library").thresholds().near, 100.0
    scale, shift = (
        (-2 / (far - near), -(far + near) / (far - near))
        if camera.orthographic
        else (-(far + near) / (far - near), -2 * far * near / (far - near))
    )
    constants = {
        "modelview": Matrix(flip @ camera.viewmat), "lens": (small.K[0, 0], small.K[1, 1], small.K[0, 2],
        small.K[1, 2]),
        "view": (small.width, small.height, near, 1.0), "mode": (float(camera.orthographic),
        float(scene.antialiased), scale, shift),
    }  # fmt: skip
    depth = bridge_gpu.depth_texture(
        np.broadcast_to(np.float32(hidden), (camera.height, camera.width)), reduction
    )
    target = bridge_gpu.Target(small.width, small.height)
    bridge_gpu.draw_quads(shaders, target, lists, depth, constants, scene.count)
    with target.frame.bind():
        values = target.frame.read_color(0, 0, small.width, small.height, 4, 0, "FLOAT")
    values.dimensions = small.width * small.height * 4
    return np.array(values, np.float32).reshape(small.height, small.width, 4)[::-1]


@pytest.mark.parametrize("orthographic", [False, True])
@pytest.mark.parametrize("antialiased", [False, True])
def test_all_quads_are_the_rasterizers_picture(shaders, antialiased, orthographic):
    """To the 11 bits of the half floats they are blended in."""
    native = part("svrgs_addon.native.rasterizer")
    scene, camera = replace(scenes.room(2000), antialiased=antialiased), scenes.orbit_camera(SIDE, SIDE // 2)
    if orthographic:
        camera = replace(camera, K=camera.K @ np.diag([0.15, 0.15, 1]), orthographic=True)
    expected = native.Rasterizer().forward(
        scene, camera, native.RenderOptions(antialiased=antialiased), outputs=("rgb", "alpha")
    )
    drawn = quads_picture(shaders, scene, camera)
    assert expected["alpha"].mean() > 0.3
    np.testing.assert_allclose(drawn[..., :3], expected["rgb"], atol=0.012)
    np.testing.assert_allclose(drawn[..., 3], expected["alpha"], atol=0.012)
    assert np.abs(drawn[..., :3] - expected["rgb"]).mean() < 0.002


def test_what_is_in_front_hides_them(shaders):
    scene, camera = scenes.room(500), scenes.orbit_camera(SIDE, SIDE // 2)
    assert (
        quads_picture(shaders, scene, camera).any()
        and not quads_picture(shaders, scene, camera, hidden=0.0).any()
    )


def test_fewer_pixels_show_the_same_picture(shaders):
    scene, camera = scenes.room(2000), scenes.orbit_camera(4 * SIDE, 2 * SIDE)
    whole, small = quads_picture(shaders, scene, camera), quads_picture(shaders, scene, camera, reduction=2)
    blocks = whole.reshape(SIDE, 2, 2 * SIDE, 2, 4).mean(axis=(1, 3))
    assert small.shape == blocks.shape and np.abs(small - blocks).mean() < 0.03


def test_a_thin_line_in_front_leaves_no_dots_in_a_smaller_picture(shaders):
    """The lines of the grid and of bounds are in the viewport's depth buffer."""
    scene, camera = scenes.room(2000), scenes.orbit_camera(4 * SIDE, 2 * SIDE)
    line = np.ones((2 * SIDE, 4 * SIDE), np.float32)
    line[np.arange(2 * SIDE), np.arange(2 * SIDE)] = 0.0
    np.testing.assert_array_equal(
        quads_picture(shaders, scene, camera, line, reduction=4),
        quads_picture(shaders, scene, camera, reduction=4),
    )
    assert (quads_picture(shaders, scene, camera, line) != quads_picture(shaders, scene, camera)).any(), (
        "at full size it hides what is behind it"
    )


def test_blender_does_not_complain_about_the_push_constants(shaders, capfd):
    part("operators.data.gpu_drawing").Shaders()
    ctypes.CDLL(None).fflush(None)
    assert "Push constants" not in "".join(capfd.readouterr())
