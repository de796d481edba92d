"""Pictures under a moving camera."""

from __future__ import annotations

import numpy as np
import pytest

import scenes
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_bench.preview import Preview
from svrgs_bench.scenes import orbit_camera, room


@pytest.fixture(scope="module")
def scene():
    return room(2000)


def test_every_picture_is_that_of_the_scene(scene):
    """Another order in memory may swap Gaussians at one depth: none is here."""
    preview = Preview(scene)
    for turn in (0.0, 1.0, 90.0, 1.0):
        camera = orbit_camera(64, 40, turn)
        np.testing.assert_array_equal(preview.image(camera), Rasterizer().forward(scene, camera)["rgb"])


def test_a_camera_at_rest_costs_nothing(scene):
    preview = Preview(scene)
    first = preview.image(orbit_camera(64, 40))
    assert preview.image(orbit_camera(64, 40)) is first
    assert preview.image(orbit_camera(64, 40, 5)) is not first
    assert preview.image(orbit_camera(80, 40, 5)).shape == (40, 80, 3)


def test_a_picture_handed_out_cannot_be_changed(scene):
    with pytest.raises(ValueError, match="read-only"):
        Preview(scene).image(orbit_camera(16, 16))[0, 0] = 1


def test_an_empty_scene_is_black():
    assert not Preview(scenes.empty_scene()).image(orbit_camera(16, 16)).any()
