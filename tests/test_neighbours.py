"""Distances to the nearest points, held against all pairs, and against SciPy's tree bit by bit."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.scene.neighbours import nearest_distances, nearest_rows

RNG = np.random.default_rng(0)
CLOUDS = {
    "four points": RNG.normal(size=(4, 3)),
    "one leaf": RNG.normal(size=(32, 3)),
    "two leaves": RNG.normal(size=(33, 3)),
    "cube": RNG.uniform(size=(3000, 3)),
    "plane": np.c_[RNG.uniform(size=(3000, 2)), np.zeros(3000)],
    "line": np.c_[RNG.uniform(size=3000), np.zeros((3000, 2))],
    "far outliers": RNG.standard_cauchy(size=(5000, 3)) ** 3,
    "clusters": RNG.normal(size=(20, 1, 3)).repeat(150, axis=1).reshape(-1, 3) * 100
    + RNG.normal(size=(3000, 3)),
    "every point five times": RNG.normal(size=(400, 3)).repeat(5, axis=0),
    "one place": np.ones((500, 3)),
}


@pytest.mark.parametrize("name", CLOUDS)
def test_the_nearest_of_all_pairs(name):
    points = CLOUDS[name].astype(np.float32).astype(np.float64)
    dx, dy, dz = (points[:, None, axis] - points[:, axis] for axis in range(3))
    squares = dx * dx + dy * dy + dz * dz
    np.fill_diagonal(squares, np.inf)
    assert np.array_equal(nearest_distances(points, 3), np.sqrt(np.sort(squares, axis=1)[:, :3]))


@pytest.mark.parametrize("name", [name for name in CLOUDS if len(CLOUDS[name]) > 30])
def test_the_nearest_rows_have_the_smallest_distances(name):
    points = CLOUDS[name].astype(np.float32).astype(np.float64)
    rows = nearest_rows(points, 30)
    assert (np.diff(np.sort(rows, axis=1), axis=1) > 0).all()
    assert (rows != np.arange(len(points))[:, None]).all()
    dx, dy, dz = (points[:, None, axis] - points[rows, axis] for axis in range(3))
    assert np.array_equal(
        np.sqrt(np.sort(dx * dx + dy * dy + dz * dz, axis=1)), nearest_distances(points, 30)
    )


@pytest.mark.parametrize("name", ["cube", "far outliers", "every point five times"])
def test_the_bits_of_scipy(name):
    spatial = pytest.importorskip("scipy.spatial")
    points = CLOUDS[name].astype(np.float32)
    assert np.array_equal(nearest_distances(points, 3), spatial.cKDTree(points).query(points, k=4)[0][:, 1:])
