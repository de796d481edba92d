"""The native Adam against torch's, and on SH coefficients against its formula."""

import numpy as np
import pytest
import torch

from native_helpers import FLOAT_LEVELS, LEVELS, rasterizer
from svrgs_addon.finetune.moments import packed, unpacked, zero_moments
from svrgs_addon.native import library
from svrgs_addon.system.errors import NativeError

pytestmark = pytest.mark.usefixtures("default_threads")


def steps_of(n: int, width: int, dtype, steps: int = 20, seed: int = 0):
    """Parameters and a sequence of gradients over many magnitudes."""
    rng = np.random.default_rng(seed)
    shape = (n, width) if width > 1 else (n,)
    scale = 10.0 ** rng.uniform(-6, 1, shape)
    return rng.normal(size=shape).astype(dtype), [
        (rng.normal(size=shape) * scale).astype(dtype) for _ in range(steps)
    ]


def torch_step(
    param, moments, grad, step: int, groups: list[dict], **settings
) -> tuple[np.ndarray, np.ndarray]:
    """(param, moments) after one step of torch's Adam from the same; groups: the settings of each column."""
    twins = [torch.tensor(column) for column in columns_of(param)]
    optimiser = torch.optim.Adam(
        [{"params": [twin], **group} for twin, group in zip(twins, groups, strict=True)], **settings
    )
    state = [columns_of(moment) for moment in unpacked(moments, param.shape)]
    for twin, g, m, v in zip(twins, columns_of(grad), *state, strict=True):
        twin.grad = torch.tensor(g)
        optimiser.state[twin] = dict(
            step=torch.tensor(step - 1.0), exp_avg=torch.tensor(m), exp_avg_sq=torch.tensor(v)
        )
    optimiser.step()
    states = [optimiser.state[twin] for twin in twins]
    m, v = (np.stack([s[name] for s in states], 1).reshape(param.shape) for name in ("exp_avg", "exp_avg_sq"))
    return np.stack(twins, 1).reshape(param.shape), packed(m, v, step)


def columns_of(array: np.ndarray) -> list[np.ndarray]:
    return [column.copy() for column in array.reshape(len(array), -1).T]


# words the same as torch's, packed by finetune/moments.py; the others were nearly rounded the other way
PACKED_ALIKE = 0.985


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
        expected, _ = torch_step(
            param, moments, grad, step, [{"lr": rate} for rate in rates], betas=(0.8, 0.95), eps=1e-3
        )
        r.adam(param, moments, grad, None, lr=rates, step=step, betas=(0.8, 0.95), eps=1e-3)
        np.testing.assert_allclose(param, expected, rtol=tolerance, atol=tolerance)
    np.testing.assert_array_equal(param[:, 1], start[:, 1])


@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_packed_moments_follow_those_in_64_bits_without_bias(level):
    """Over 3,000 steps: m 0.013 % of the gradient's spread about the true one, v 14 % of itself, both in the
    mean on it."""
    r, rng = rasterizer(level), np.random.default_rng(4)
    scale = 10.0 ** rng.uniform(-15, 18, 4096)
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
        assert (
            r.adam(*sparse, rows, ids, lr=0.02, step=step)
            == r.adam(*dense, rows, None, lr=0.02, step=step)
            == 0
        )
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
    assert (
        r.adam(param, zero_moments(param), np.empty((0, 3), r.dtype), np.empty(0, np.uint32), lr=1.0, step=1)
        == 0
    )
    assert (param == 1).all()


@pytest.mark.parametrize("ids", [[0, 9], [5, 3], [3, 3]])
def test_adam_refuses_rows_outside_the_array_or_out_of_order(ids):
    r = rasterizer("scalar")
    param = np.ones((9, 3), np.float32)
    with pytest.raises(ValueError, match="ids"):
        r.adam(
            param, zero_moments(param), np.ones((2, 3), np.float32), np.array(ids, np.uint32), lr=1.0, step=1
        )
    assert (param == 1).all()


@pytest.mark.parametrize("share", [0.05, 0.5, 1.0])
def test_adam_has_the_same_bits_for_any_number_of_threads(share):
    r = rasterizer(library.best_level())
    start, grads = steps_of(20_000, 3, r.dtype, steps=2)
    ids = np.flatnonzero(np.random.default_rng(2).random(20_000) < share).astype(np.uint32)
    results = set()
    for threads in (1, 2, 3, 7, 16):
        library.set_threads(threads)
        arrays = [start.copy(), zero_moments(start)]
        for step, grad in enumerate(grads, 1):
            r.adam(*arrays, np.ascontiguousarray(grad[ids]), None if share == 1 else ids, lr=0.02, step=step)
        results.add(b"".join(a.tobytes() for a in arrays))
    assert len(results) == 1


# --- Adam on SH coefficients: one second moment a Gaussian


def shared_step(param, m, v, grad, step: int, rates, betas=(0.9, 0.999), eps=1e-15):
    """What is written in svrgs.h, in the arrays' type: (param, m, v) after one step."""
    m = betas[0] * m + (1 - betas[0]) * grad
    v = betas[1] * v + (1 - betas[1]) * (grad[:, 0] ** 2).mean(axis=1)
    root = np.sqrt(v / (1 - betas[1] ** step)) + eps
    return param - rates.reshape(param.shape[1:]) * (m / (1 - betas[0] ** step)) / root[:, None, None], m, v


def sh_steps_of(n: int, coefficients: int, dtype):
    """Parameters (n, K, 3), rates of their columns, and gradients over many magnitudes, each Gaussian's of
    one."""
    rng, shape = np.random.default_rng(coefficients), (n, coefficients, 3)
    scale = 10.0 ** rng.uniform(-6, 1, (n, 1, 1))
    return (
        rng.normal(size=shape).astype(dtype),
        rng.uniform(1e-3, 1e-1, 3 * coefficients),
        [(rng.normal(size=shape) * scale).astype(dtype) for _ in range(20)],
    )


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
        np.testing.assert_allclose(
            param, expected, rtol=2e-6 if single else 1e-12, atol=2e-6 if single else 1e-12
        )
        np.testing.assert_allclose(found_m, m, rtol=2**-7 if single else 1e-12, atol=1e-12)
        np.testing.assert_allclose(found_v, v, rtol=1e-6 if single else 1e-12)
        assert packed(found_m, found_v, 0).shape == moments.shape
        assert packed(found_m, found_v, 0).dtype == moments.dtype
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
        assert (moments.view(np.uint16) == expected.view(np.uint16))[
            :, : 3 * coefficients
        ].mean() >= PACKED_ALIKE


@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_first_moments_in_16_bits_follow_those_in_64_without_bias(level):
    """Over 1,000 steps of gradients that hardly change: rounded to nearest, m would stop short of them by up
    to 2 %."""
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
    """The same bits as a dense step on those rows alone; other rows, and those with a NaN, keep theirs and
    are counted."""
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
