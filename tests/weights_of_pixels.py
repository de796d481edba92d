"""What the pixels of a view say of each Gaussian, by the float64 reference: slopes of colours, dominated
pixels, sums of alpha T."""

from __future__ import annotations

import numpy as np
import torch

from native_helpers import BACKGROUND
from reference import rasterize as reference
from svrgs_addon.scene.gaussians import PARAMETERS


def parts(scene, camera, antialiased: bool = False):
    """The reference's splats, alpha (P, V) and hits (P, V)."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K = (torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K))
    splats = reference.project(*tensors, viewmat, K, camera.width, camera.height, 1, antialiased)
    return splats, *reference.alphas(splats, reference.pixel_centres(camera.width, camera.height))


def expected_slopes(scene, masks: np.ndarray, camera, antialiased: bool = False) -> np.ndarray:
    """(N,) by autograd: every pair of pixel and Gaussian has a G of its own, whose slope in the sum of the
    channels is squared and summed."""
    splats, alpha, hit = parts(scene, camera, antialiased)
    # of a clamped alpha too: the clamp is not differentiated
    G = torch.where(hit, alpha / splats.opacity, 0.0).requires_grad_()
    M = torch.tensor(np.asarray(masks, np.float64))[splats.index]
    background = torch.tensor(BACKGROUND, dtype=torch.float64)
    reference.blend(splats.opacity * G, hit, M, splats.colour, splats.z, background)[0].sum().backward()
    full = np.zeros(scene.count)
    full[splats.index.numpy()] = (torch.where(hit, G.grad, 0.0) ** 2).sum(0).numpy()
    return full


def weights(scene, masks: np.ndarray, camera) -> np.ndarray:
    """alpha T (P, N), 0 where a Gaussian is not blended."""
    splats, alpha, _ = parts(scene, camera)
    M = torch.tensor(np.asarray(masks, np.float64))[splats.index]
    T = reference.transmittance(alpha, M)
    blended = torch.cumprod((T[:, 1:] >= reference.T_MIN).long(), 1).bool()
    full = np.zeros((len(alpha), scene.count))
    full[:, splats.index.numpy()] = torch.where(blended, M * alpha * T[:, :-1], 0.0).numpy()
    return full


def expected_dominance(scene, masks: np.ndarray, camera) -> np.ndarray:
    """(N,) pixels in which the Gaussian has the largest alpha T."""
    found = weights(scene, masks, camera)
    winners = found.argmax(axis=1)[found.max(axis=1) > 0]
    return np.bincount(winners, minlength=scene.count).astype(np.float64)
