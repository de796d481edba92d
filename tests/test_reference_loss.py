"""The reference loss against values by hand and finite differences."""

import numpy as np
import pytest
import torch

from reference import loss
from reference.gradients import central_difference


def test_ssim_at_a_corner_by_hand():
    """Zeros outside the image, weights not renormalised."""
    rng = np.random.default_rng(0)
    x, y = rng.random((2, 13, 9, 3))
    offsets = np.arange(11) - 5
    w = np.exp(-(offsets**2) / (2 * 1.5**2))
    w = np.outer(w, w) / w.sum() ** 2
    px, py = (np.pad(i[..., 1], 5)[1:12, 0:11] for i in (x, y))  # around row 1, column 0
    mx, my = (w * px).sum(), (w * py).sum()
    vx, vy, cov = (w * px * px).sum() - mx**2, (w * py * py).sum() - my**2, (w * px * py).sum() - mx * my
    expected = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    assert loss.ssim_map(torch.tensor(x), torch.tensor(y))[1, 0, 1].item() == pytest.approx(
        expected, rel=1e-12
    )


def test_loss_of_equal_images_is_zero_and_weights_are_as_published():
    x, y = torch.rand(2, 8, 7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert loss.photometric_loss(x, x).item() == pytest.approx(0, abs=1e-14)
    expected = 0.8 * (x - y).abs().mean() + 0.2 * (1 - loss.ssim(x, y))
    assert loss.photometric_loss(x, y).item() == pytest.approx(expected.item(), abs=1e-15)


def test_loss_gradient_is_the_finite_difference():
    x, y = torch.rand(2, 6, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    x.requires_grad_()
    loss.photometric_loss(x, y).backward()
    difference = central_difference(lambda image: loss.photometric_loss(image, y), x)
    torch.testing.assert_close(x.grad, difference, rtol=1e-6, atol=1e-9)


def test_mask_loss_counts_empty_pixels():
    F = torch.tensor([[3.0, 0.0], [0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    loss.mask_loss(F).backward()
    assert loss.mask_loss(F).item() == 2.5
    np.testing.assert_allclose(F.grad, F.detach() / 2)
