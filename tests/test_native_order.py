"""Each pixel takes its Gaussians nearest first, whatever their depths are like: compared with the sum in that
order."""

from __future__ import annotations

import numpy as np
import pytest

from native_helpers import LEVELS, frontal, isotropic, render

COUNT, OPACITY, SH_C0 = 3_000, 0.02, 0.28209479177387814
ULP = float(np.spacing(np.float32(3)))


def near_each_other(rng) -> np.ndarray:
    return 3 + ULP * rng.permutation(COUNT)


def with_one_far_behind(rng) -> np.ndarray:
    """So that their keys differ in the last bits only, and one in the first: what a sort by leading bits
    leaves undone."""
    return np.r_[near_each_other(rng)[1:], 1e6]


DEPTHS = {
    "few": lambda rng: rng.uniform(1, 9, 5),
    "spread": lambda rng: rng.uniform(0.3, 1e3, COUNT),
    "near each other": near_each_other,
    "with one far behind": with_one_far_behind,
    "in layers": lambda rng: rng.integers(1, 8, COUNT).astype(float),
    "equal": lambda rng: np.full(COUNT, 3.0),
    "from behind": lambda rng: np.linspace(9, 1, COUNT),
}


@pytest.mark.parametrize("depths", DEPTHS)
@pytest.mark.parametrize("level", LEVELS)
def test_the_nearest_come_first_and_equal_ones_in_row_order(level, depths):
    rng = np.random.default_rng(7)
    z = DEPTHS[depths](rng).astype(np.float32)
    colours = rng.random((len(z), 3))
    scene = isotropic([(0, 0, depth) for depth in z], opacity=OPACITY, dc=0)
    scene.sh[:, 0] = (colours - 0.5) / SH_C0
    image = render(level, scene, frontal(1, 1), background=(0, 0, 0))
    order = np.argsort(z, kind="stable")
    weights = OPACITY * (1 - OPACITY) ** np.arange(len(z))
    drawn = (1 - OPACITY) ** (np.arange(len(z)) + 1) >= 1e-4
    np.testing.assert_allclose(image["rgb"][0, 0], (weights * drawn) @ colours[order], atol=2e-5)
    assert image["hits"].item() == len(z)
