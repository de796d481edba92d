"""The native loss against the reference loss, finite differences, and itself on other threads."""

import numpy as np
import pytest
import torch

from native_helpers import FLOAT_LEVELS, LEVELS, rasterizer, relative_l2
from reference import loss as ref_loss
from svrgs_addon.native import library
from svrgs_addon.system.errors import NativeError

pytestmark = pytest.mark.usefixtures("default_threads")

VALUE_BOUND = 1.0e-7  # relative; worst seen 8.4e-8, scalar and baseline
LOSS_GRADIENT_BOUND = 5.2e-7  # relative L2; worst seen 4.82e-7, scalar and baseline
# three smaller than the window, one of four tiles
SIZES = [(1, 1), (1, 40), (3, 5), (11, 11), (17, 33), (40, 29), (95, 170)]


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


@pytest.mark.parametrize("level", [library.best_level(), "float64"])
def test_loss_has_the_same_bits_for_any_number_of_threads(level):
    image, target = image_pair(190, 330)
    results = []
    for threads in (1, 2, 3, 7, 16):
        library.set_threads(threads)
        l1, ssim, grad = native_loss(level, image, target)
        results.append((l1, ssim, grad.tobytes()))
    assert len(set(results)) == 1


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("size", [(1, 1), (3, 5), (95, 170), (300, 170)])
def test_mask_loss_is_the_mean_square_of_f(size, level):
    r = rasterizer(level)
    F = np.random.default_rng(1).gamma(2, 0.4, size).astype(r.dtype)
    value, grad = r.mask_loss(F, 0.3)
    exact = F.astype(np.float64)
    assert value == pytest.approx(np.square(exact).mean(), rel=1e-7 if r.dtype == np.float32 else 1e-13)
    np.testing.assert_allclose(grad, 0.6 * exact / F.size, rtol=2e-7 if r.dtype == np.float32 else 1e-14)


def test_mask_loss_does_not_depend_on_the_number_of_threads_and_refuses_an_empty_mask():
    r, F = rasterizer(library.best_level()), np.random.default_rng(2).random((300, 171), np.float32)
    found = []
    for threads in (1, 2, 5):
        library.set_threads(threads)
        value, grad = r.mask_loss(F, 0.1)
        found.append((value, grad.tobytes()))
    assert len(set(found)) == 1
    with pytest.raises(NativeError, match="pixels"):
        r.mask_loss(F[:0], 0.1)
