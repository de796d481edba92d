"""Cameras, perspective and orthographic: what stays as it is when the world or the image changes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.scene.camera import Camera, evenly

CAMERAS = {
    name: (scenes.CAMERAS | scenes.ORTHOGRAPHIC)[name]
    for name in ("rotated", "off_centre", "parallel_rotated", "parallel_off_centre")
}
POINTS = np.random.default_rng(0).normal(0, 0.5, (30, 3))


def seen(camera, points) -> tuple[np.ndarray, np.ndarray]:
    """Pixels and depths of points of the world."""
    local = points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    return camera.pixels(local), local[:, 2]


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_a_world_moved_turned_and_scaled_is_seen_at_the_same_pixels(camera):
    matrix = 2.5 * scenes.camera(9, 9, eye=(1, 2, -3), roll=40).viewmat
    matrix[3, 3] = 1
    moved = camera.moved(matrix)
    (pixels, z) = seen(moved, POINTS)
    (expected, depth) = seen(camera, POINTS @ matrix[:3, :3].T + matrix[:3, 3])
    np.testing.assert_allclose(pixels, expected, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(z, depth / 2.5, rtol=1e-12)
    np.testing.assert_allclose(moved.viewmat[:3, :3] @ moved.viewmat[:3, :3].T, np.eye(3), atol=1e-12)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_another_image_size_scales_the_pixels(camera):
    pixels = seen(camera, POINTS)[0]
    np.testing.assert_allclose(
        seen(camera.resized(2 * camera.width, 3 * camera.height), POINTS)[0], pixels * (2, 3)
    )
    np.testing.assert_allclose(seen(camera.reduced(4), POINTS)[0], pixels / 4)


@pytest.mark.parametrize("camera", CAMERAS.values(), ids=CAMERAS)
def test_the_camera_looks_along_the_ray_of_each_pixel(camera):
    directions = camera.directions(POINTS)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=1), 1)
    np.testing.assert_allclose(seen(camera, POINTS + directions)[0], seen(camera, POINTS)[0], atol=1e-9)


def test_keys_tell_views_apart():
    camera = scenes.CAMERAS["plain"]
    assert camera.key == replace(camera, name="other").key
    others = (
        replace(camera, orthographic=True),
        camera.resized(34, 21),
        replace(camera, viewmat=camera.viewmat + np.eye(4)),
        replace(camera, K=2 * camera.K),
    )
    assert len({camera.key, *(other.key for other in others)}) == 5


def test_a_view_is_made_to_fit_but_never_enlarged():
    camera = Camera(np.eye(4), np.array([[100.0, 0, 60], [0, 100, 30], [0, 0, 1]]), 120, 60)
    small = camera.fitted(40)
    assert (small.width, small.height) == (40, 20) and small.K[0, 0] == pytest.approx(100 / 3)
    assert small.K[1, 2] == pytest.approx(10)
    assert (camera.fitted(1_000).K == camera.K).all() and camera.fitted(1_000).width == 120


def test_some_of_many_views_are_spread_evenly():
    cameras = [Camera(np.eye(4), np.eye(3), 1, 1, str(number)) for number in range(10)]
    assert [camera.name for camera in evenly(cameras, 4)] == ["0", "3", "6", "9"]
    assert evenly(cameras, 99) == cameras and evenly(cameras[:1], 3) == cameras[:1]
