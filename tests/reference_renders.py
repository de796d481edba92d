"""Images of the reference rasterizer as arrays, and Gaussians and a camera that are simple by hand."""

import math
from dataclasses import fields

import numpy as np
import torch

import scenes
from reference import rasterize as ref
from svrgs_addon.scene.camera import Camera

BACKGROUND = (0.2, 0.5, 0.9)
IMAGES = [f.name for f in fields(ref.Render)]


def frontal(width: int, height: int, focal: float = 20.0) -> Camera:
    """A camera at the origin looking along +z, principal point in the middle."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(np.eye(4), K, width, height)


def gaussians(means, scale=0.1, opacity=0.5, dc=0.4) -> dict[str, torch.Tensor]:
    """Isotropic Gaussians of one opacity and grey SH coefficient, as float64 leaves."""
    n = len(means)
    arrays = {
        "means": np.asarray(means, dtype=float),
        "log_scales": np.full((n, 3), math.log(scale)),
        "quats": np.tile([1.0, 0, 0, 0], (n, 1)),
        "opacity_logits": np.full(n, math.log(opacity / (1 - opacity))),
        "sh": np.full((n, 1, 3), dc),
    }
    return {k: torch.tensor(v, requires_grad=True) for k, v in arrays.items()}


def images(params, masks, camera, **options) -> dict[str, np.ndarray]:
    """Every image of a render, as arrays."""
    render = scenes.reference_render(params, masks, camera, BACKGROUND, **options)
    return {name: getattr(render, name).detach().numpy() for name in IMAGES}


def weighted_sum(render: ref.Render, seed: int = 0) -> torch.Tensor:
    """A scalar that reads every differentiable image with random weights of either sign."""
    rng = torch.Generator().manual_seed(seed)
    parts = (render.rgb, 0.1 * render.depth, render.alpha, render.F)
    return sum(
        (image * torch.randn(image.shape, generator=rng, dtype=torch.float64)).mean() for image in parts
    )
