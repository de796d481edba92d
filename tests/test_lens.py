"""Blender's camera numbers and intrinsics, there and back; tests/blender holds them against Blender's own matrices."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.lens import Lens, intrinsics, lens_of


@pytest.mark.parametrize("camera", scenes.CAMERAS.values(), ids=scenes.CAMERAS)
def test_intrinsics_survive_the_way_through_blenders_numbers(camera):
    np.testing.assert_allclose(intrinsics(lens_of(camera)), camera.K, rtol=1e-12, atol=1e-9)


def test_square_pixels_stay_square():
    assert lens_of(scenes.CAMERAS["plain"]).aspect == (1.0, 1.0)


@pytest.mark.parametrize("fit, focal", [("AUTO", 50 * 100 / 36), ("HORIZONTAL", 50 * 100 / 36), ("VERTICAL", 50 * 80 / 24)])
def test_the_fitted_side_sets_the_focal_length(fit, focal):
    K = intrinsics(Lens(100, 80, 50.0, (0.1, -0.2), sensor=(36, 24), fit=fit))
    side = 80 if fit == "VERTICAL" else 100
    np.testing.assert_allclose(K, [[focal, 0, 50 - 0.1 * side], [0, focal, 40 - 0.2 * side], [0, 0, 1]])


def test_a_portrait_is_fitted_to_its_height():
    lens = Lens(80, 100, 50.0)
    assert intrinsics(lens)[0, 0] == pytest.approx(50 * 100 / 36)
    assert intrinsics(replace(lens, aspect=(2.0, 1.0)))[0, 0] == pytest.approx(50 * 80 / 36)  # pixels twice as wide: a landscape
