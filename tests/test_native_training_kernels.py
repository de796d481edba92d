"""The loss, Adam and the sampling of masks: against the reference loss, torch's Adam and the logistic distribution."""

import numpy as np
import pytest
import torch

from native_helpers import FLOAT_LEVELS, LEVELS, rasterizer, relative_l2
from reference import loss as ref_loss
from svrgs_addon import native
from svrgs_addon.errors import NativeError
from svrgs_addon.finetune.moments import packed, unpacked, zero_moments
from svrgs_addon.native import sample_masks


@pytest.fixture(autouse=True)
def default_threads():
    yield
    native.set_threads(0)


# --- loss


VALUE_BOUND = 1.0e-7  # relative; worst seen 8.4e-8, scalar and baseline
LOSS_GRADIENT_BOUND = 5.2e-7  # relative L2; worst seen 4.82e-7, scalar and baseline
SIZES = [(1, 1), (1, 40), (3, 5), (11, 11), (17, 33), (40, 29), (95, 170)]  # three smaller than the window, one of four tiles


def image_pair(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A smooth image and a noisy copy, a little outside [0, 1], a tenth of the values equal."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width][..., None]
    target = 0.5 + 0.4 * np.sin(0.3 * x + np.arange(3)) * np.cos(0.2 * y)
    image = target + rng.normal(0, 0.2, target.shape) * (rng.random(target.shape) > 0.1)
    return image.astype(np.float32), target.astype(np.float32)


def reference_loss(image, target, l1_weight=0.8, ssim_weight=0.2):
    x = torch.tensor(image, dtype=torch.float64, requires_grad=True)
    y = torch.tensor(target, dtype=torch.float64)
    l1, ssim = ref_loss.l1(x, y), ref_loss.ssim(x, y)
    (l1_weight * l1 + ssim_weight * (1 - ssim)).backward()
    return l1.item(), ssim.item(), x.grad.numpy()


def native_loss(level: str, image, target, **options):
    r = rasterizer(level)
    l1, ssim, grad = r.loss(image.astype(r.dtype), target.astype(r.dtype), **options)
    return l1, ssim, None if grad is None else grad.copy()


@pytest.mark.parametrize("size", SIZES)
@pytest.mark.parametrize("weights", [(0.8, 0.2), (1.0, 1.0), (1.0, 0.0), (0.0, 1.0)])
def test_float64_loss_equals_the_reference(size, weights):
    image, target = image_pair(*size)
    l1, ssim, grad = native_loss("float64", image, target, l1_weight=weights[0], ssim_weight=weights[1])
    expected = reference_loss(image, target, *weights)
    assert (l1, ssim) == pytest.approx(expected[:2], rel=1e-13)
    np.testing.assert_allclose(grad, expected[2], rtol=1e-9, atol=1e-15)


@pytest.mark.parametrize("level", FLOAT_LEVELS)
@pytest.mark.parametrize("size", SIZES)
def test_float_losses_agree_with_the_reference(size, level):
    for seed in range(3):
        image, target = image_pair(*size, seed)
        l1, ssim, grad = native_loss(level, image, target)
        expected = reference_loss(image, target)
        assert (l1, ssim) == pytest.approx(expected[:2], rel=VALUE_BOUND)
        assert relative_l2(grad, expected[2]) <= LOSS_GRADIENT_BOUND


@pytest.mark.parametrize("level", LEVELS)
def test_identical_images_have_ssim_one_and_no_l1_gradient(level):
    image, _ = image_pair(17, 33)
    l1, ssim, grad = native_loss(level, image, image, l1_weight=1.0, ssim_weight=0.0)
    assert l1 == 0 and ssim == pytest.approx(1, abs=1e-6 if level != "float64" else 1e-14)
    assert not grad.any()


@pytest.mark.parametrize("level", LEVELS)
def test_l1_gradient_is_a_sign_and_zero_at_ties(level):
    image, target = image_pair(17, 33)
    assert (image == target).mean() > 0.05
    grad = native_loss(level, image, target, l1_weight=1.0, ssim_weight=0.0)[2]
    np.testing.assert_allclose(grad, np.sign(image - target) / image.size, rtol=1e-6)


def test_loss_gradient_is_the_finite_difference():
    image, target = (x.astype(np.float64) for x in image_pair(6, 8, 1))
    image[image == target] += 0.01  # away from the kink
    grad = native_loss("float64", image, target)[2]
    for at in np.ndindex(image.shape):
        values = []
        for step in (-1e-6, 1e-6):
            moved = image.copy()
            moved[at] += step
            l1, ssim, _ = native_loss("float64", moved, target, want_grad=False)
            values.append(0.8 * l1 + 0.2 * (1 - ssim))
        assert grad[at] == pytest.approx((values[1] - values[0]) / 2e-6, rel=1e-6, abs=1e-9)


@pytest.mark.parametrize("level", LEVELS)
def test_loss_values_do_not_depend_on_the_gradient_being_wanted(level):
    image, target = image_pair(40, 29)
    with_grad, without = (native_loss(level, image, target, want_grad=want) for want in (True, False))
    assert with_grad[:2] == without[:2] and without[2] is None


@pytest.mark.parametrize("level", [native.best_level(), "float64"])
def test_loss_has_the_same_bits_for_any_number_of_threads(level):
    image, target = image_pair(190, 330)
    results = []
    for threads in (1, 2, 3, 7, 16):
        native.set_threads(threads)
        l1, ssim, grad = native_loss(level, image, target)
        results.append((l1, ssim, grad.tobytes()))
    assert len(set(results)) == 1


# --- Adam


def steps_of(n: int, width: int, dtype, steps: int = 20, seed: int = 0):
    """Parameters and a sequence of gradients over many magnitudes."""
    rng = np.random.default_rng(seed)
    shape = (n, width) if width > 1 else (n,)
    scale = 10.0 ** rng.uniform(-6, 1, shape)
    return rng.normal(size=shape).astype(dtype), [(rng.normal(size=shape) * scale).astype(dtype) for _ in range(steps)]


def torch_step(param, moments, grad, step: int, groups: list[dict], **settings) -> tuple[np.ndarray, np.ndarray]:
    """(param, moments) after one step of torch's Adam from the same; groups: the settings of each column."""
    twins = [torch.tensor(column) for column in columns_of(param)]
    optimiser = torch.optim.Adam([{"params": [twin], **group} for twin, group in zip(twins, groups, strict=True)], **settings)
    state = [columns_of(moment) for moment in unpacked(moments, param.shape)]
    for twin, g, m, v in zip(twins, columns_of(grad), *state, strict=True):
        twin.grad = torch.tensor(g)
        optimiser.state[twin] = {"step": torch.tensor(step - 1.0), "exp_avg": torch.tensor(m), "exp_avg_sq": torch.tensor(v)}
    optimiser.step()
    states = [optimiser.state[twin] for twin in twins]
    m, v = (np.stack([s[name] for s in states], 1).reshape(param.shape) for name in ("exp_avg", "exp_avg_sq"))
    return np.stack(twins, 1).reshape(param.shape), packed(m, v, step)


def columns_of(array: np.ndarray) -> list[np.ndarray]:
    return [column.copy() for column in array.reshape(len(array), -1).T]


PACKED_ALIKE = 0.985  # words the same as torch's, packed by finetune/moments.py; the others were nearly rounded the other way


def assert_moments_agree(found: np.ndarray, expected: np.ndarray, dtype):
    if dtype == np.float64:
        for a, b in zip(unpacked(found, found.shape), unpacked(expected, found.shape), strict=True):
            np.testing.assert_allclose(a, b, rtol=1e-12, atol=1e-15)
        return
    assert (found == expected).mean() >= PACKED_ALIKE
    for a, b, bits in zip(unpacked(found, found.shape), unpacked(expected, found.shape), (8, 3), strict=True):
        np.testing.assert_allclose(a, b, rtol=2**-bits, atol=1e-12)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("width", [1, 3, 4, 12, 48])
def test_adam_is_that_of_torch(level, width):
    """20 dense steps from zero moments, each from the same state, eps as 3DGS sets it."""
    r = rasterizer(level)
    start, grads = steps_of(101, width, r.dtype)
    param, moments = start.copy(), zero_moments(start)
    tolerance = 1e-6 if r.dtype == np.float32 else 1e-12
    for step, grad in enumerate(grads, 1):
        expected, expected_moments = torch_step(param, moments, grad, step, [{}] * width, lr=0.02, eps=1e-15)
        assert r.adam(param, moments, grad, None, lr=0.02, step=step) == 0
        np.testing.assert_allclose(param, expected, rtol=tolerance, atol=tolerance)
        assert_moments_agree(moments, expected_moments, r.dtype)
    assert np.median(np.abs(param - start)) > 1e-2


@pytest.mark.parametrize("level", LEVELS)
def test_adam_takes_other_settings_and_a_rate_per_column(level):
    r = rasterizer(level)
    start, grads = steps_of(37, 5, r.dtype)
    rates = np.array([1e-3, 0, 0.5, 2e-2, 1e-4])
    param, moments = start.copy(), zero_moments(start)
    tolerance = 2e-6 if r.dtype == np.float32 else 1e-12
    for step, grad in enumerate(grads, 1):
        expected, _ = torch_step(param, moments, grad, step, [{"lr": rate} for rate in rates], betas=(0.8, 0.95), eps=1e-3)
        r.adam(param, moments, grad, None, lr=rates, step=step, betas=(0.8, 0.95), eps=1e-3)
        np.testing.assert_allclose(param, expected, rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(param[:, 1], start[:, 1])


@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_packed_moments_follow_those_in_64_bits_without_bias(level):
    """Over 3,000 steps: m 0.013 % of the gradient's spread about the true one, v 14 % of itself, both in the mean on it."""
    r, rng = rasterizer(level), np.random.default_rng(4)
    scale = 10.0 ** rng.uniform(-8, 1, 4096)
    param = np.zeros(4096, r.dtype)
    moments, m, v = zero_moments(param), np.zeros(4096), np.zeros(4096)
    for step in range(1, 3001):
        grad = (scale * rng.normal(0.5, 1, 4096)).astype(r.dtype)
        r.adam(param, moments, grad, None, lr=1e-3, step=step)
        m, v = 0.9 * m + 0.1 * grad, 0.999 * v + 0.001 * grad.astype(np.float64) ** 2
    found_m, found_v = unpacked(moments, param.shape)
    error, ratio = (found_m - m) / scale, found_v / v
    assert abs(error.mean()) < 1e-5 and error.std() < 3e-4
    assert abs(ratio.mean() - 1) < 8e-3 and ratio.std() < 0.2


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("width", [1, 3, 4, 48])
def test_sparse_adam_updates_only_its_rows(level, width):
    """The same bits as a dense step on those rows alone; every other row keeps its bits."""
    r = rasterizer(level)
    start, grads = steps_of(203, width, r.dtype)
    ids = np.sort(np.random.default_rng(1).choice(203, 90, replace=False)).astype(np.uint32)
    sparse = [start.copy(), packed(grads[0], grads[1] ** 2, 1)]
    dense = [x[ids].copy() for x in sparse]
    before = [x.copy() for x in sparse]
    for step, grad in enumerate(grads[:3], 1):
        rows = np.ascontiguousarray(grad[ids])
        assert r.adam(*sparse, rows, ids, lr=0.02, step=step) == r.adam(*dense, rows, None, lr=0.02, step=step) == 0
    others = np.setdiff1d(np.arange(203), ids)
    for now, alone, was in zip(sparse, dense, before, strict=True):
        assert now[ids].tobytes() == alone.tobytes()
        assert now[others].tobytes() == was[others].tobytes()
        assert (now[ids] != was[ids]).any()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("ids", [None, np.arange(60, dtype=np.uint32)])
def test_adam_skips_and_counts_rows_that_are_not_finite(level, ids):
    r = rasterizer(level)
    start, grads = steps_of(60, 3, r.dtype)
    moments = packed(grads[0], grads[1] ** 2, 1)
    good, bad = [start.copy(), moments.copy()], [start.copy(), moments.copy()]
    poisoned, rows = grads[2].copy(), [0, 1, 17, 40, 59]
    poisoned[rows, [0, 1, 2, 0, 1]] = np.nan, np.inf, -np.inf, np.nan, np.inf
    assert r.adam(*good, grads[2], None, lr=0.02, step=1) == 0
    assert r.adam(*bad, poisoned, ids, lr=0.02, step=1) == 5
    others = np.setdiff1d(np.arange(60), rows)
    for now, expected, was in zip(bad, good, (start, moments), strict=True):
        assert now[others].tobytes() == expected[others].tobytes()
        assert now[rows].tobytes() == was[rows].tobytes()


# --- Adam on SH coefficients: one second moment a Gaussian


def shared_step(param, m, v, grad, step: int, rates, betas=(0.9, 0.999), eps=1e-15):
    """What is written in svrgs.h, in the arrays' type: (param, m, v) after one step."""
    m = betas[0] * m + (1 - betas[0]) * grad
    v = betas[1] * v + (1 - betas[1]) * (grad[:, 0] ** 2).mean(axis=1)
    root = np.sqrt(v / (1 - betas[1] ** step)) + eps
    return param - rates.reshape(param.shape[1:]) * (m / (1 - betas[0] ** step)) / root[:, None, None], m, v


def sh_steps_of(n: int, coefficients: int, dtype):
    """Parameters (n, K, 3), rates of their columns, and gradients over many magnitudes, each Gaussian's of one."""
    rng, shape = np.random.default_rng(coefficients), (n, coefficients, 3)
    scale = 10.0 ** rng.uniform(-6, 1, (n, 1, 1))
    return rng.normal(size=shape).astype(dtype), rng.uniform(1e-3, 1e-1, 3 * coefficients), [(rng.normal(size=shape) * scale).astype(dtype) for _ in range(20)]


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("level", LEVELS)
def test_sh_coefficients_share_the_second_moment_of_degree_0(level, coefficients):
    """20 dense steps from zero moments, each from the same state, against the formula in float64."""
    r = rasterizer(level)
    param, rates, grads = sh_steps_of(53, coefficients, r.dtype)
    moments, start, single = zero_moments(param), param.copy(), r.dtype == np.float32
    for step, grad in enumerate(grads, 1):
        state = [a.astype(np.float64) for a in (param, *unpacked(moments, param.shape))]
        expected, m, v = shared_step(*state, grad.astype(np.float64), step, rates)
        assert r.adam(param, moments, grad, None, lr=rates, step=step) == 0
        found_m, found_v = unpacked(moments, param.shape)
        np.testing.assert_allclose(param, expected, rtol=2e-6 if single else 1e-12, atol=2e-6 if single else 1e-12)
        np.testing.assert_allclose(found_m, m, rtol=2**-7 if single else 1e-12, atol=1e-12)
        np.testing.assert_allclose(found_v, v, rtol=1e-6 if single else 1e-12)
        assert (packed(found_m, found_v, 0).shape, packed(found_m, found_v, 0).dtype) == (moments.shape, moments.dtype)
    assert np.median(np.abs(param - start)) > 1e-2


@pytest.mark.parametrize("coefficients", [1, 4, 9, 16])
@pytest.mark.parametrize("level", LEVELS)
def test_shared_moments_are_packed_as_said(level, coefficients):
    """As moments.py packs them."""
    r = rasterizer(level)
    param, rates, grads = sh_steps_of(53, coefficients, r.dtype)
    moments, before = packed(grads[0], (grads[0][:, 0] ** 2).mean(axis=1), 1), param.copy()
    _, m, v = shared_step(before, *unpacked(moments, param.shape), grads[1], 2, rates)
    r.adam(param, moments, grads[1], None, lr=rates, step=2)
    expected = packed(m.astype(r.dtype), v.astype(r.dtype), 2)
    if r.dtype == np.float64:
        np.testing.assert_allclose(moments, expected, rtol=1e-12)
    else:
        assert (moments.view(np.uint16) == expected.view(np.uint16))[:, : 3 * coefficients].mean() >= PACKED_ALIKE


@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_first_moments_in_16_bits_follow_those_in_64_without_bias(level):
    """Over 1,000 steps of gradients that hardly change: rounded to nearest, m would stop short of them by up to 2 %."""
    r, rng = rasterizer(level), np.random.default_rng(4)
    param = np.zeros((256, 16, 3), r.dtype)
    goal = 10.0 ** rng.uniform(-8, 1, (256, 1, 1)) * rng.normal(size=param.shape)
    moments, m = zero_moments(param), np.zeros(param.shape)
    for step in range(1, 1001):
        grad = (goal * (1 + 1e-3 * rng.normal(size=param.shape))).astype(r.dtype)
        r.adam(param, moments, grad, None, lr=1e-3, step=step)
        m = 0.9 * m + 0.1 * grad
    ratio = unpacked(moments, param.shape)[0] / m
    assert abs(ratio.mean() - 1) < 2e-4 and ratio.std() < 1e-2


@pytest.mark.parametrize("coefficients", [1, 9, 16])
@pytest.mark.parametrize("level", LEVELS)
def test_sh_of_some_rows_and_rows_that_are_not_finite(level, coefficients):
    """The same bits as a dense step on those rows alone; other rows, and those with a NaN, keep theirs and are counted."""
    r = rasterizer(level)
    start, rates, grads = sh_steps_of(90, coefficients, r.dtype)
    ids = np.sort(np.random.default_rng(1).choice(90, 40, replace=False)).astype(np.uint32)
    sparse = [start.copy(), packed(grads[0], (grads[0][:, 0] ** 2).mean(axis=1), 1)]
    before = [x.copy() for x in sparse]
    dense, rows = [x[ids] for x in sparse], np.ascontiguousarray(grads[1][ids])
    rows[[3, 39], [0, -1], 2] = np.nan, np.inf
    assert r.adam(*sparse, rows, ids, lr=rates, step=2) == r.adam(*dense, rows, None, lr=rates, step=2) == 2
    moved = np.delete(ids, [3, 39])
    for now, alone, was in zip(sparse, dense, before, strict=True):
        assert now[ids].tobytes() == alone.tobytes()
        assert (now[moved] != was[moved]).reshape(len(moved), -1).any(axis=1).all()
        np.testing.assert_array_equal(np.delete(now, moved, axis=0), np.delete(was, moved, axis=0))


def test_sh_rows_of_another_width_are_refused():
    param = np.zeros((5, 2, 3), np.float32)
    with pytest.raises(NativeError, match="SH coefficients"):
        rasterizer("scalar").adam(param, zero_moments(param), param.copy(), None, lr=0.1, step=1)


@pytest.mark.parametrize("level", LEVELS)
def test_adam_with_zero_gradient_and_moments_stays_put(level):
    r = rasterizer(level)
    param, zero = np.ones((9, 3), r.dtype), np.zeros((9, 3), r.dtype)
    assert r.adam(param, zero_moments(zero), zero, None, lr=1.0, step=1) == 0
    assert (param == 1).all()


@pytest.mark.parametrize("level", LEVELS)
def test_adam_of_no_rows_does_nothing(level):
    r = rasterizer(level)
    param = np.ones((9, 3), r.dtype)
    assert r.adam(param, zero_moments(param), np.empty((0, 3), r.dtype), np.empty(0, np.uint32), lr=1.0, step=1) == 0
    assert (param == 1).all()


@pytest.mark.parametrize("ids", [[0, 9], [5, 3], [3, 3]])
def test_adam_refuses_rows_outside_the_array_or_out_of_order(ids):
    r = rasterizer("scalar")
    param = np.ones((9, 3), np.float32)
    with pytest.raises(ValueError, match="ids"):
        r.adam(param, zero_moments(param), np.ones((2, 3), np.float32), np.array(ids, np.uint32), lr=1.0, step=1)
    assert (param == 1).all()


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_adam_has_the_same_bits_for_any_number_of_threads(share):
    r = rasterizer(native.best_level())
    start, grads = steps_of(20_000, 3, r.dtype, steps=2)
    ids = np.flatnonzero(np.random.default_rng(2).random(20_000) < share).astype(np.uint32)
    results = set()
    for threads in (1, 2, 3, 7, 16):
        native.set_threads(threads)
        arrays = [start.copy(), zero_moments(start)]
        for step, grad in enumerate(grads, 1):
            r.adam(*arrays, np.ascontiguousarray(grad[ids]), None if share == 1 else ids, lr=0.02, step=step)
        results.add(b"".join(a.tobytes() for a in arrays))
    assert len(results) == 1


# --- sampling of masks


def sigmoid(x):
    return 1 / (1 + np.exp(-np.asarray(x, np.float64)))


def draw(logit: float, n: int, seed: int = 1, step: int = 0):
    return sample_masks(np.full(n, logit, np.float32), seed, step)


def noise_of(n: int, seed: int, step: int) -> np.ndarray:
    """The logistic noise, read from a draw at logit 0: slope = y (1 − y), M tells on which side of 1/2 y lies."""
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
        np.testing.assert_array_equal(array, longer[:n])  # a Gaussian's draw does not depend on how many follow
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
            assert abs(np.corrcoef(series[first][lag:], series[first][:-lag])[0, 1]) < 5 / np.sqrt(n), (first, lag)
    assert len({values.tobytes() for values in series.values()}) == len(keys)


def test_draws_do_not_depend_on_the_number_of_threads():
    logits = np.random.default_rng(0).normal(0, 3, 50_000).astype(np.float32)
    results = set()
    for threads in (1, 2, 3, 7, 16):
        native.set_threads(threads)
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


@pytest.mark.parametrize(("logit", "mask"), [(np.inf, 1), (1e30, 1), (60, 1), (-60, 0), (-1e30, 0), (-np.inf, 0)])
def test_settled_logits_draw_a_certain_mask_with_a_finite_slope(logit, mask):
    masks, slope = draw(logit, 10_000)
    assert (masks == mask).all() and (slope >= 0).all() and slope.max() < 1e-15


def test_no_gaussians_draw_nothing():
    masks, slope = draw(0, 0)
    assert masks.shape == slope.shape == (0,)
