"""The sampling of masks against the logistic distribution."""

import numpy as np
import pytest

from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import sample_masks

pytestmark = pytest.mark.usefixtures("default_threads")


def sigmoid(x):
    return 1 / (1 + np.exp(-np.asarray(x, np.float64)))


def draw(logit: float, n: int, seed: int = 1, step: int = 0):
    return sample_masks(np.full(n, logit, np.float32), seed, step)


def noise_of(n: int, seed: int, step: int) -> np.ndarray:
    """The logistic noise, read from a draw at logit 0: slope = y (1 − y), M tells on which side of 1/2 y
    lies."""
    masks, slope = draw(0, n, seed, step)
    root = np.sqrt(1 - 4 * slope.astype(np.float64).clip(max=0.25))
    small = 2 * slope / (1 + root)  # the smaller of y and 1 − y, without cancellation
    y = np.where(masks == 1, 1 - small, small)
    return np.log(y) - np.log1p(-y)


@pytest.mark.parametrize("logit", [-4.0, -1.0, 0.0, 2.0, 9.0])
def test_gaussians_are_kept_with_the_probability_of_their_logit(logit):
    n = 1_000_000
    masks, _ = draw(logit, n)
    p = sigmoid(logit)
    assert masks.mean() == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / n))
    assert set(np.unique(masks)) == {0, 1}


def test_initial_logit_keeps_all_but_one_in_8104():
    assert sigmoid(9) == pytest.approx(0.999877, abs=5e-7)
    dropped = sum((draw(9, 500_000, step=step)[0] == 0).sum() for step in range(4))
    assert dropped == pytest.approx(2_000_000 / 8104, abs=5 * np.sqrt(247))


def test_noise_is_logistic():
    """Kolmogorov–Smirnov distance of sigma(noise) from uniform, at the 1e-6 level."""
    n = 100_000
    u = np.sort(sigmoid(noise_of(n, 3, 4)))
    distance = np.abs(u - (np.arange(n) + 0.5) / n).max()
    assert distance < 2.7 / np.sqrt(n)


def test_mask_and_slope_are_those_of_logit_plus_noise():
    n = 50_000
    noise = noise_of(n, 5, 6)
    logits = np.random.default_rng(0).normal(0, 3, n).astype(np.float32)
    masks, slope = sample_masks(logits, 5, 6)
    z = logits + noise
    clear = np.abs(z) > 0.01
    np.testing.assert_array_equal(masks[clear], z[clear] > 0)
    usual = np.abs(noise) < 7  # beyond, and within 0.05 of 0, the float32 slope no longer tells the noise
    usual &= np.abs(noise) > 0.05
    np.testing.assert_allclose(slope[usual], (sigmoid(z) * sigmoid(-z))[usual], rtol=1e-4)
    assert usual.mean() > 0.9 and slope.min() > 0 and slope.max() <= 0.25


def test_draws_depend_on_seed_step_and_index_alone():
    n = 10_000
    expected = draw(0.5, n, 7, 8)
    for array, again in zip(expected, draw(0.5, n, 7, 8), strict=True):
        np.testing.assert_array_equal(array, again)
    for array, longer in zip(expected, draw(0.5, n + 12_345, 7, 8), strict=True):
        # a Gaussian's draw does not depend on how many follow
        np.testing.assert_array_equal(array, longer[:n])
    assert draw(0.5, n, 2**64 - 1, 2**64 - 1)[0].mean() == pytest.approx(sigmoid(0.5), abs=0.03)


def test_draws_differ_without_correlation():
    """Between steps, seeds and neighbours; also where step + 1 of one seed might meet another seed."""
    n = 200_000
    series = {key: noise_of(n, *key) for key in [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0), (0, 1000)]}
    keys = list(series)
    for i, first in enumerate(keys):
        for second in keys[i + 1 :]:
            assert abs(np.corrcoef(series[first], series[second])[0, 1]) < 5 / np.sqrt(n), (first, second)
        for lag in (1, 2, 64):
            assert abs(np.corrcoef(series[first][lag:], series[first][:-lag])[0, 1]) < 5 / np.sqrt(n), (
                first,
                lag,
            )
    assert len({values.tobytes() for values in series.values()}) == len(keys)


def test_draws_do_not_depend_on_the_number_of_threads():
    logits = np.random.default_rng(0).normal(0, 3, 50_000).astype(np.float32)
    results = set()
    for threads in (1, 2, 3, 7, 16):
        library.set_threads(threads)
        results.add(b"".join(a.tobytes() for a in sample_masks(logits, 1, 2)))
    assert len(results) == 1


def test_ten_draws_remove_a_one_in_ten_gaussian_with_probability_0_3487():
    n = 200_000
    drawn = np.zeros(n, bool)
    for step in range(10):
        drawn |= draw(np.log(0.1 / 0.9), n, 11, step)[0] == 1
    p = 0.9**10
    assert p == pytest.approx(0.3487, abs=5e-5)
    assert (~drawn).mean() == pytest.approx(p, abs=5 * np.sqrt(p * (1 - p) / n))


@pytest.mark.parametrize(
    ("logit", "mask"), [(np.inf, 1), (1e30, 1), (60, 1), (-60, 0), (-1e30, 0), (-np.inf, 0)]
)
def test_settled_logits_draw_a_certain_mask_with_a_finite_slope(logit, mask):
    masks, slope = draw(logit, 10_000)
    assert (masks == mask).all() and (slope >= 0).all() and slope.max() < 1e-15


def test_no_gaussians_draw_nothing():
    masks, slope = draw(0, 0)
    assert masks.shape == slope.shape == (0,)
