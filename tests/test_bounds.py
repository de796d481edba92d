"""Boxes and views around the mass of a scene, not around its outliers."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.scene.bounds import (
    body_box,
    clipping,
    corners,
    median_depth,
    robust_box,
    sphere_around,
    viewing_distance,
)
from svrgs_addon.scene.camera import Camera


def test_outliers_do_not_widen_the_box():
    points = np.random.default_rng(0).uniform(-1, 1, (10_000, 3)).astype(np.float32)
    points[:100] *= 1e6
    points[100] = np.nan
    points[101, 1] = np.inf
    assert np.abs(robust_box(points) - [[-1] * 3, [1] * 3]).max() < 0.05


def test_a_background_all_around_does_not_either():
    rng = np.random.default_rng(3)
    sky = rng.normal(size=(3000, 3))
    sky *= 60 / np.linalg.norm(sky, axis=1, keepdims=True)
    assert np.abs(robust_box(np.concatenate([rng.uniform(-1, 1, (7000, 3)), sky]))).max() < 3


def test_limbs_belong_to_the_body_but_floaters_and_a_sky_do_not():
    rng = np.random.default_rng(4)
    body, head = rng.uniform(-1, 1, (9_700, 3)), rng.uniform(-0.1, 0.1, (200, 3)) + [0, 1.9, 0]
    sky = rng.uniform(-1, 1, (100, 3)) + [0, 0, 40]
    points = np.concatenate([body, head, sky])
    low, high = body_box(points)
    assert 1.8 < high[1] < 2.1 and robust_box(points)[1, 1] < 1.2
    assert np.abs(high[[0, 2]]).max() < 1.2 and np.abs(low).max() < 1.2
    assert body_box(np.empty((0, 3))) is None


def test_what_is_faint_counts_little():
    rng = np.random.default_rng(1)
    points = np.concatenate([rng.uniform(-1, 1, (500, 3)), rng.uniform(50, 60, (500, 3))])
    weights = np.r_[np.ones(500), np.full(500, 0.01)]
    assert robust_box(points, weights)[1].max() < 1.2 and 20 < robust_box(points)[1].min()
    assert robust_box(points, np.zeros(1000)) is None and robust_box(np.empty((0, 3))) is None


def test_quantiles_are_those_of_equal_weights():
    points = np.random.default_rng(2).normal(size=(2000, 3))
    low, high = np.quantile(points, (0.2, 0.8), axis=0)
    assert np.allclose(robust_box(points).mean(axis=0), (low + high) / 2, atol=5e-3)
    assert np.allclose(np.ptp(robust_box(points), axis=0), (high - low) / 0.6, atol=5e-3)
    assert np.array_equal(robust_box(points[:1]), np.repeat(points[:1], 2, axis=0))


def test_many_points_are_sampled_over_the_whole_list():
    points = np.linspace(0, 1, 3 * 1_000_003).reshape(-1, 3)
    assert np.allclose(robust_box(points), [[0] * 3, [1] * 3], atol=1e-4)


def test_the_median_depth_is_of_what_the_camera_shows():
    points = np.array(
        [[0, 0, 2], [0, 0, 3], [0.1, 0, 7], [0, 0, -5], [90, 0, 3], [0, 0, np.nan], [0, 0, 100]]
    )
    camera = Camera(np.eye(4), np.array([[50.0, 0, 32], [0, 50, 24], [0, 0, 1]]), 64, 48)
    assert median_depth(camera, points[:6]) == 3
    assert median_depth(camera, points, np.r_[1, 1, 1, 1, 1, 1, 1e6]) == pytest.approx(100, abs=1)
    assert median_depth(camera, points[3:5]) is None and median_depth(camera, points, np.zeros(7)) is None


def test_the_sphere_holds_the_turned_box():
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2 * np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]), (5, 0, 0)
    places = corners(np.array([[0, 0, 0], [1, 2, 3]]), matrix)
    assert places.shape == (8, 3) and np.allclose(places.min(0), (1, 0, 0))
    assert np.allclose(places.max(0), (5, 2, 6))
    centre, radius = sphere_around(places)
    assert np.allclose(centre, (3, 1, 3)) and np.isclose(radius, np.sqrt(1 + 4 + 9) / 2 * 2)


@pytest.mark.parametrize("size", [(1600, 900), (900, 1600), (500, 500)])
def test_a_sphere_just_fits(size):
    """Its outline, seen from there, touches the edge of the shorter side."""
    distance = viewing_distance(2.0, 50.0, *size, sensor=72.0)
    outline = np.tan(np.arcsin(2.0 / distance))  # half the picture of the sphere at distance 1
    assert np.isclose(outline, 72 / 2 / 50 * min(size) / max(size))


def test_clipping_is_widened_where_that_is_needed():
    assert clipping(5, 0.01, 1000) == (0.01, 1000), "what fits stays"
    assert clipping(0.1, 0.01, 1000) == (0.001, 1000)
    start, end = clipping(5000, 0.01, 1000)
    assert end == 500_000 and start == 0.5
