"""What the graphics card draws over viewports, where Blender draws without a window (5.2 on)."""

from __future__ import annotations

import ctypes
import ctypes.util

import gpu
import numpy as np
import pytest
from extension import part

HEIGHT, WIDTH = 20, 32


@pytest.fixture(scope="module")
def drawing():
    """The module gpu_drawing, with a graphics card."""
    if not hasattr(gpu, "init") or not ctypes.util.find_library("EGL"):
        pytest.skip(
            "this Blender does not draw with the graphics card in background mode, or libEGL is missing"
        )
    gpu.init()
    return part("operators.data.gpu_drawing")


def drawn(draw, color=(0.0, 0.0, 0.0, 0.0)) -> np.ndarray:
    """(H, W, 4), rows from the top: what draw() leaves of a buffer of one colour."""
    texture = gpu.types.GPUTexture((WIDTH, HEIGHT), format="RGBA32F")
    frame = gpu.types.GPUFrameBuffer(color_slots=(texture,))
    with frame.bind():
        frame.clear(color=color)
        draw()
        values = frame.read_color(0, 0, WIDTH, HEIGHT, 4, 0, "FLOAT")
    values.dimensions = WIDTH * HEIGHT * 4
    return np.array(values, np.float32).reshape(HEIGHT, WIDTH, 4)[::-1]


def test_a_picture_is_drawn_upright_and_linear(drawing):
    rng, linear = np.random.default_rng(0), part("svrgs_addon.native.pictures").linear_colours
    alpha = rng.random((HEIGHT, WIDTH), np.float32)
    rgb = rng.random((HEIGHT, WIDTH, 3), np.float32) * alpha[..., None]
    texture = drawing.picture_texture(np.dstack([rgb, alpha]))
    seen = drawn(lambda: drawing.draw_over_viewport(drawing.picture_shader(), texture))
    np.testing.assert_allclose(seen, linear(rgb, alpha, np.eye(3)), atol=2e-3)  # of half floats


def test_only_the_columns_of_a_side_are_drawn(drawing):
    texture = drawing.picture_texture(np.ones((HEIGHT, WIDTH, 4), np.float32))
    seen = drawn(lambda: drawing.draw_over_viewport(drawing.picture_shader(), texture, (0.25, 0.5)))
    assert (seen[:, 8:16] == 1).all() and seen.sum() == 4 * 8 * HEIGHT


def test_lines_stay_in_front_of_gaussians_alone(drawing):
    """A picture at z = 2 in its left half, in units of which one is 3 of the projection, and lines before it,
    behind it, and on it."""
    z = np.full((HEIGHT, WIDTH), 1e10, np.float32)
    z[:, : WIDTH // 2] = 2.0
    near, far = 0.1, 100.0
    P = -(far + near) / (far - near), -2 * far * near / (far - near), -1.0, 0.0
    buffered = lambda depth: 0.5 * (P[1] - P[0] * depth) / depth + 0.5
    lines = np.ones((HEIGHT, WIDTH), np.float32)
    for row, depth in enumerate((5.9, 6.0, 6.1)):
        lines[row] = buffered(depth)
    textures = {name: drawing.picture_texture(values) for name, values in (("depth", z), ("lines", lines))}
    seen = drawn(
        lambda: drawing.draw_hiding(drawing.hiding_shader(), textures, {"lens": P, "depths": (3.0, 0.0)}),
        color=(0.5, 0.5, 0.5, 1.0),
    )
    kept = np.ones((HEIGHT, WIDTH), bool)
    kept[2:, : WIDTH // 2] = False
    np.testing.assert_array_equal(seen[..., 3] == 1, kept)


def test_a_thin_line_in_front_hides_nothing_in_a_smaller_picture():
    """The lines of bounds are in the viewport's depth buffer."""
    farthest = part("operators.data.gpu_drawing").farthest
    depth = np.ones((18, 26), np.float32)
    assert farthest(depth, 1) is None
    depth[np.arange(18), np.arange(18)] = 0.5
    np.testing.assert_array_equal(farthest(depth, 1), depth)
    assert farthest(depth, 4) is None
    depth[:9] = 0.25
    found = farthest(depth, 4)
    assert found.shape == (4, 6) and (found[:2] == 0.25).all() and (found[2:] == 1).all()


def test_blender_does_not_complain_about_the_push_constants(drawing, capfd):
    drawing.hiding_shader()
    ctypes.CDLL(None).fflush(None)
    assert "Push constants" not in "".join(capfd.readouterr())


def test_a_moving_view_has_as_many_pixels_as_there_is_time_for():
    """And does not go back to a size that was too slow unless there is time to spare."""
    view = part("operators.view.overlay").View()
    try:
        seen = []
        for seconds in (0.01, 0.01, 0.02, 0.04, 0.01, 0.005, 0.05, 0.05, 0.05):
            seen.append(view.reduction)
            view.adapt(seconds)
        assert seen == [4, 2, 1, 1, 2, 2, 1, 2, 4]
    finally:
        view.live.close()
