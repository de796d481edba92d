"""Blender's camera numbers and intrinsics, there and back; tests/blender holds them against Blender's own
matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.views.lens import (
    Lens,
    camera_of_projection,
    depth_of_projection,
    intrinsics,
    lens_of,
    step_back,
)


@pytest.mark.parametrize("camera", scenes.CAMERAS.values(), ids=scenes.CAMERAS)
def test_intrinsics_survive_the_way_through_blenders_numbers(camera):
    np.testing.assert_allclose(intrinsics(lens_of(camera)), camera.K, rtol=1e-12, atol=1e-9)


def test_square_pixels_stay_square():
    assert lens_of(scenes.CAMERAS["plain"]).aspect == (1.0, 1.0)


@pytest.mark.parametrize(
    "fit, focal", [("AUTO", 50 * 100 / 36), ("HORIZONTAL", 50 * 100 / 36), ("VERTICAL", 50 * 80 / 24)]
)
def test_the_fitted_side_sets_the_focal_length(fit, focal):
    K = intrinsics(Lens(100, 80, 50.0, (0.1, -0.2), sensor=(36, 24), fit=fit))
    side = 80 if fit == "VERTICAL" else 100
    np.testing.assert_allclose(K, [[focal, 0, 50 - 0.1 * side], [0, focal, 40 - 0.2 * side], [0, 0, 1]])


def test_a_portrait_is_fitted_to_its_height():
    lens = Lens(80, 100, 50.0)
    assert intrinsics(lens)[0, 0] == pytest.approx(50 * 100 / 36)
    # pixels twice as wide: a landscape
    assert intrinsics(replace(lens, aspect=(2.0, 1.0)))[0, 0] == pytest.approx(50 * 80 / 36)


@pytest.mark.parametrize("fit, side", [("AUTO", 100), ("HORIZONTAL", 100), ("VERTICAL", 80)])
def test_an_orthographic_lens_shows_its_scale_on_the_fitted_side(fit, side):
    K = intrinsics(Lens(100, 80, 50.0, (0.1, -0.2), sensor=(36, 24), fit=fit, ortho_scale=4.0))
    np.testing.assert_allclose(K, [[side / 4, 0, 50 - 0.1 * side], [0, side / 4, 40 - 0.2 * side], [0, 0, 1]])


def frustum(left, right, bottom, top, near, far) -> np.ndarray:
    """OpenGL's projection matrix, from its definition."""
    return np.array([
        [2 * near / (right - left), 0, (right + left) / (right - left), 0],
        [0, 2 * near / (top - bottom), (top + bottom) / (top - bottom), 0],
        [0, 0, -(far + near) / (far - near), -2 * far * near / (far - near)], [0, 0, -1, 0],
    ])  # fmt: skip


def box(left, right, bottom, top, near, far) -> np.ndarray:
    """OpenGL's orthographic projection matrix, from its definition."""
    low, high = np.array([left, bottom, -near]), np.array([right, top, -far])
    P = np.diag([*(2 / (high - low)), 1])
    P[:3, 3] = -(high + low) / (high - low)
    return P


@pytest.mark.parametrize(
    "P, behind",
    [
        (frustum(-0.3, 0.5, -0.2, 0.1, 0.5, 90), 0),
        (box(-3, 5, -2, 1, 0.5, 90), 0),
        (box(-3, 5, -2, 1, -20, 20), 20),
    ],
    ids=["perspective", "orthographic", "around the eye"],
)
def test_a_viewports_projection_and_its_camera_show_points_at_the_same_pixels(P, behind):
    points = np.random.default_rng(0).uniform((-2, -2, -9), (2, 2, 15 if behind else -1), (20, 3))
    clip = np.c_[points, np.ones(20)] @ P.T
    ndc = clip[:, :3] / clip[:, 3:]
    camera = camera_of_projection(P, np.eye(4), 320, 200)
    seen = points * (1, -1, -1) + camera.viewmat[:3, 3]
    np.testing.assert_allclose(
        camera.pixels(seen), np.c_[(ndc[:, 0] + 1) * 160, (1 - ndc[:, 1]) * 100], atol=1e-9
    )
    np.testing.assert_allclose(depth_of_projection(P, (ndc[:, 2] + 1) / 2), seen[:, 2], rtol=1e-5)
    assert np.isinf(depth_of_projection(P, np.ones(1))).all()
    assert step_back(P) == pytest.approx(behind, abs=1e-9) and (seen[:, 2] > 0).all()
