"""The numerical error of the float32 levels: images and gradients, compared with the float64 level of the
same case."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np

from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.gaussians import PARAMETERS

from .cases import Case
from .trial import LAMBDA_F, WANTED, drawn_masks, target_of


class _Rendered:
    """A case rendered at one level: its images, and its gradients with one row per Gaussian of the scene."""

    def __init__(self, case: Case, level: str | None, masks: np.ndarray, full: bool):
        self.rasterizer = Rasterizer(level)
        self.dtype, self.count = self.rasterizer.dtype, case.scene.count
        self.scene = SimpleNamespace(
            **{name: getattr(case.scene, name).astype(self.dtype, copy=False) for name in PARAMETERS}
        )
        options = RenderOptions(antialiased=case.scene.antialiased, full=full, mask_kind="svr")
        self.images = self.rasterizer.forward(
            self.scene, case.camera, options, masks, ("rgb", "mask", "hits")
        )

    def backward(self, image_grads: dict[str, np.ndarray]):
        self.grads = self.rasterizer.backward(
            {name: grad.astype(self.dtype) for name, grad in image_grads.items()}, WANTED
        )
        self.ids = self.rasterizer.visible()

    def grad(self, name: str) -> np.ndarray:
        """The gradient of a parameter, flat, (N * width,) float64; 0 for Gaussians that are not visible."""
        rows = self.grads[name]
        full = np.zeros((self.count, *rows.shape[1:]))
        full[self.ids] = rows
        return full.ravel()


def error(
    case: Case,
    level: str | None = None,
    masks: np.ndarray | None = None,
    lambda_f: float = LAMBDA_F,
    full: bool = False,
) -> dict:
    """The errors of a level, with these keys: image_max, image_mean, mask_max; grad_rel_l2 and grad_cosine of
    the worst parameter; nonfinite: number of values that are not finite; crossed.

    In a pixel where the levels disagree on whether a Gaussian passes a threshold, they differ by a whole
    Gaussian. Such pixels are left out, and `crossed` is their share. masks (N,) uint8: by default 9 of 10
    Gaussians exist. full: F counts every hit of a ray.
    """
    masks = drawn_masks(case.scene.count)[0] if masks is None else masks
    ours, exact = _Rendered(case, level, masks, full), _Rendered(case, "float64", masks, full)
    same = ours.images["hits"] == exact.images["hits"]
    grads = _image_grads(ours, same, lambda_f)
    ours.backward(grads)
    exact.backward(grads)
    rgb, mask = (np.abs(ours.images[name] - exact.images[name])[same] for name in ("rgb", "mask"))
    distances = [_distance(ours.grad(name), exact.grad(name)) for name in WANTED]
    return {
        "image_max": float(rgb.max(initial=0)),
        "image_mean": float(rgb.mean()) if rgb.size else 0.0,
        "mask_max": float(mask.max(initial=0)),
        "grad_rel_l2": max(distance for distance, _ in distances),
        "grad_cosine": min(cosine for _, cosine in distances),
        "nonfinite": sum(
            int((~np.isfinite(array)).sum()) for array in (*ours.images.values(), *ours.grads.values())
        ),
        "crossed": 1.0 - float(same.mean()),
    }


def _image_grads(rendered: _Rendered, weight: np.ndarray, lambda_f: float) -> dict[str, np.ndarray]:
    """dL/drgb and dL/dF of a fine-tuning step, 0 where weight (H, W) is 0."""
    rgb = rendered.images["rgb"]
    d_rgb = rendered.rasterizer.loss(rgb, target_of(rgb))[2]
    return {
        "rgb": d_rgb * weight[..., None],
        "mask": rendered.rasterizer.mask_loss(rendered.images["mask"], lambda_f)[1] * weight,
    }


def _distance(ours: np.ndarray, exact: np.ndarray) -> tuple[float, float]:
    """(relative L2 distance, cosine) of two gradients; (0, 1) if both are 0."""
    norm, other = np.linalg.norm(exact), np.linalg.norm(ours)
    if not norm or not other:
        return float(norm != other), float(norm == other)
    return float(np.linalg.norm(ours - exact) / norm), float(np.dot(ours, exact) / (norm * other))
