"""The photometric and mask losses in float64; autograd supplies the gradients. Images are (H, W, 3)."""

from __future__ import annotations

import torch
from torch import Tensor

WINDOW = 11  # px
SIGMA = 1.5  # px
C1, C2 = 1e-4, 9e-4
SSIM_WEIGHT = 0.2


def window() -> Tensor:
    """Normalised Gaussian window (11, 11)."""
    offsets = torch.arange(WINDOW, dtype=torch.float64) - WINDOW // 2
    g = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    return torch.outer(g, g) / g.sum() ** 2


def local_mean(image: Tensor) -> Tensor:
    """Window average at every pixel, per channel; zeros outside the image (H, W, C) → (H, W, C)."""
    planes = image.permute(2, 0, 1)[:, None]
    return torch.nn.functional.conv2d(planes, window()[None, None], padding=WINDOW // 2)[:, 0].permute(
        1, 2, 0
    )


def ssim_map(x: Tensor, y: Tensor) -> Tensor:
    """SSIM at every pixel and channel (H, W, 3)."""
    mean_x, mean_y = local_mean(x), local_mean(y)
    var_x = local_mean(x * x) - mean_x**2
    var_y = local_mean(y * y) - mean_y**2
    cov = local_mean(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return luminance * (2 * cov + C2) / (var_x + var_y + C2)


def ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean of the SSIM map over pixels and channels, a scalar."""
    return ssim_map(x, y).mean()


def l1(x: Tensor, y: Tensor) -> Tensor:
    """Mean absolute difference, a scalar."""
    return (x - y).abs().mean()


def photometric_loss(x: Tensor, y: Tensor, ssim_weight: float = SSIM_WEIGHT) -> Tensor:
    """0.8 L1 + 0.2 (1 − SSIM) by default."""
    return (1 - ssim_weight) * l1(x, y) + ssim_weight * (1 - ssim(x, y))


def mask_loss(F: Tensor) -> Tensor:
    """Mean of F² over the image, empty pixels included as 0: eq. mask-loss-mean-energy."""
    return (F * F).mean()
