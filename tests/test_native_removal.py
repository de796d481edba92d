"""What a Gaussian is worth: the error its absence would cause, against renders that really leave it out."""

import numpy as np
import pytest

import scenes
from native_helpers import LEVELS, rasterizer, render

BOUND = {"float64": 1e-10}  # of the largest cost; worst seen 2e-14, float levels 3e-6
FLOAT_BOUND = 1e-5
COUNT = 40


def faint_scene(seed: int):
    """No ray is stopped, so that leaving one Gaussian out changes nothing else."""
    scene = scenes.random_scene(COUNT, seed, 1, scale=0.3)
    scene.opacity_logits[:] = np.minimum(scene.opacity_logits, -1.0)
    return scene


def residuals_of(level: str, image: np.ndarray, photograph: np.ndarray) -> np.ndarray:
    return (image - photograph).astype(rasterizer(level).dtype)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("masked", [False, True])
def test_cost_is_the_error_without_the_gaussian(level, masked):
    camera = scenes.camera(37, 29)
    scene, _ = scenes.away_from_thresholds(faint_scene(5), camera, np.ones(COUNT))
    masks = scenes.random_masks(scene.count, 3) if masked else np.ones(scene.count)
    photograph = np.random.default_rng(0).random((29, 37, 3))
    images = render(level, scene, camera, masks, ("rgb",))
    cost = np.zeros(scene.count)
    rasterizer(level).add_removal(cost, residuals_of(level, images["rgb"], photograph))

    def error(masks) -> float:
        return float(((render("float64", scene, camera, masks, ("rgb",))["rgb"] - photograph) ** 2).sum())

    expected = np.zeros(scene.count)
    for i in np.flatnonzero(masks):
        without = masks.copy()
        without[i] = 0
        expected[i] = error(without) - error(masks)
    assert (expected > 0).any() and (expected < 0).any()
    np.testing.assert_allclose(
        cost, expected, rtol=0, atol=BOUND.get(level, FLOAT_BOUND) * np.abs(expected).max()
    )


@pytest.mark.parametrize("level", LEVELS)
def test_without_residuals_it_is_the_energy_of_the_change(level):
    camera = scenes.camera(37, 29)
    scene, _ = scenes.away_from_thresholds(faint_scene(6), camera, np.ones(COUNT))
    render(level, scene, camera, None, ("rgb",))
    once, twice = np.zeros(scene.count), np.zeros(scene.count)
    zeros = np.zeros((29, 37, 3), rasterizer(level).dtype)
    rasterizer(level).add_removal(once, zeros)
    for _ in range(2):
        rasterizer(level).add_removal(twice, zeros)
    assert (once >= 0).all() and (once > 0).sum() > COUNT // 4
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-14)
