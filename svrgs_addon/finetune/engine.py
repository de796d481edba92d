"""The native engine: one optimisation step with NumPy arrays and the native kernels.

An engine is any object with `step(model, step) -> StepResult`. torch_engine.py is a reference implementation
in PyTorch; this engine is tested against it.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from ..native.pictures import exposed, exposed_vjp
from ..native.rasterizer import Rasterizer, RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import PARAMETERS
from .model import MASK, Model
from .penalties import Penalty

BETAS, EPS = (0.9, 0.999), 1e-15


@dataclass
class Step:
    """The inputs of one step: a view, its photograph, learning rates, masks, the terms of the loss."""

    camera: Camera
    target: np.ndarray  # (H, W, 3) in the model's dtype, display sRGB 0..1; of the window, if there is one
    number: int  # step of the run, from 1: Adam's t
    rates: dict[str, float]  # learning rates by parameter name, as Rates.at() gives them
    options: RenderOptions
    l1_weight: float = 0.8
    ssim_weight: float = 0.2
    masks: np.ndarray | None = None  # (N,) uint8, the masks of this step; None: all 1
    slope: np.ndarray | None = None  # (N,) dM/dlogit; None: masks are not learned
    lambda_f: float = 0.0  # weight of mean F^2
    lambda_m: float = 0.0  # weight of (mean M)^2
    # masks multiply the scale too, and have a gradient only where they are 1 (Compact3DGS)
    gates: bool = False
    penalties: tuple[Penalty, ...] = ()
    # (N,) bool: Gaussians that are rendered, but not updated. Not in a step that densifies. None: none
    frozen: np.ndarray | None = None
    update: bool = True  # False: gradients only (3DGS takes no optimiser step in a step that densifies)
    want_means2d: bool = False  # the gradient of the projected centres is returned, for densification
    want_camera: bool = False  # the gradient of the camera's motion is returned
    # rows and columns of the view: outside of them, its picture counts as equal to the target. None: all
    window: tuple[slice, slice] | None = None
    # (3, 4): the photograph's exposure (exposure.py), with which the picture is seen; not with a window
    exposure: np.ndarray | None = None

    @property
    def spatial(self) -> bool:
        """Whether the step renders F and penalises it."""
        return self.lambda_f > 0 and self.masks is not None

    @property
    def global_loss(self) -> float:
        """(mean M)^2 (MaskGaussian)."""
        return float(self.masks.mean()) ** 2 if self.masks is not None else 0.0

    def penalised(self, values: Mapping[str, Any], ids) -> list[tuple[Penalty, Any]]:
        """The penalties that have a value, each with the rows of its parameter that it is given. values: all
        parameters by name. ids: the rows that the view sees. Arrays or tensors."""
        return [
            (p, values[p.parameter][ids] if p.seen else values[p.parameter])
            for p in self.penalties
            if len(ids) or not p.seen
        ]

    def not_frozen(self, ids: np.ndarray) -> np.ndarray:
        """Those of the rows `ids` that are not frozen."""
        return ids if self.frozen is None else ids[~self.frozen[ids]]

    @property
    def dense_gradients(self) -> set[str]:
        """Parameters whose gradient is not sparse: it reaches every Gaussian, not only the visible ones."""
        return ({MASK} if self.lambda_m else set()) | {
            penalty.parameter for penalty in self.penalties if not penalty.seen
        }


@dataclass
class StepResult:
    """The terms of the loss before the update, and the gradients that densification needs."""

    l1: float
    ssim: float
    mask_loss: float  # mean F^2
    # (V,) uint32: rows of the Gaussians that the view sees and that are not frozen, ascending
    visible: np.ndarray
    means2d: np.ndarray | None = None  # (V, 2) dL/d(projected centre), per pixel
    exposure: np.ndarray | None = None  # (3, 4) dL/dexposure
    camera: np.ndarray | None = None  # (6,) dL/d(the camera's motion), see Camera.displaced
    penalty: float = 0.0  # value of Step.penalties, their weights included
    nonfinite: int = 0  # rows that were not updated because their gradient was not finite

    def image_loss(self, step: Step) -> float:
        return step.l1_weight * self.l1 + step.ssim_weight * (1 - self.ssim)

    def loss(self, step: Step) -> float:
        return (
            self.image_loss(step)
            + step.lambda_f * self.mask_loss
            + step.lambda_m * step.global_loss
            + self.penalty
        )


def global_mask_grad(masks: np.ndarray, slope: np.ndarray, lambda_m: float) -> np.ndarray:
    """Gradient (N,) of lambda_m (mean M)^2 in the existence logits (MaskGaussian). slope: dM/dlogit (N,)."""
    return slope * slope.dtype.type(2 * lambda_m * float(masks.mean()) / len(masks))


class NativeEngine:
    """Forward, loss, backward and a sparse Adam step: only Gaussians that the view sees are updated."""

    def __init__(self, level: str | None = None):
        self.rasterizer = Rasterizer(level)

    def step(self, model: Model, step: Step) -> StepResult:
        r = self.rasterizer
        outputs = ("rgb", "mask") if step.spatial else ("rgb",)
        images = r.forward(model, step.camera, step.options, step.masks, outputs)
        l1, ssim, d_rgb, d_exposure = self._seen_loss(step, images["rgb"])
        image_grads, mask_loss = {"rgb": d_rgb}, 0.0
        if step.spatial:
            mask_loss, image_grads["mask"] = r.mask_loss(images["mask"], step.lambda_f)
        result = StepResult(l1, ssim, mask_loss, step.not_frozen(r.visible()), exposure=d_exposure)
        penalised = step.penalised(model.values, result.visible)
        result.penalty = float(sum(penalty.value(rows, np) for penalty, rows in penalised))
        asked = {"means2d": step.want_means2d, "camera": step.want_camera}
        wanted = tuple(name for name in asked if asked[name])
        if step.update:
            grads, result.nonfinite = self._update(model, step, image_grads, wanted, result.visible)
        else:
            grads = r.backward(image_grads, wanted)
        result.means2d = grads.get("means2d")
        if step.want_camera:
            result.camera = grads["camera"].sum(axis=0, dtype=np.float64)
        return result

    def _seen_loss(self, step: Step, rgb: np.ndarray) -> tuple[float, float, np.ndarray, np.ndarray | None]:
        """_image_loss() of the picture as the photograph's exposure shows it, and dL/dexposure."""
        if step.exposure is None:
            return *self._image_loss(step, rgb), None
        valid, level = step.camera.valid, self.rasterizer.level
        l1, ssim, d_seen = self._image_loss(step, exposed(rgb, step.exposure, valid, level))
        return l1, ssim, *exposed_vjp(d_seen, rgb, step.exposure, valid, level)

    def _image_loss(self, step: Step, rgb: np.ndarray) -> tuple[float, float, np.ndarray]:
        """Mean |difference|, SSIM and the gradient (H, W, 3) of the image loss; both values and the gradient
        are means over all pixels of the view."""
        if step.window is None:
            return self.rasterizer.loss(rgb, step.target, step.l1_weight, step.ssim_weight)
        l1, ssim, grad = self.rasterizer.loss(
            np.ascontiguousarray(rgb[step.window]), step.target, step.l1_weight, step.ssim_weight
        )
        share, whole = grad.size / rgb.size, np.zeros_like(rgb)
        np.multiply(grad, rgb.dtype.type(share), out=whole[step.window])
        return share * l1, 1 - share * (1 - ssim), whole

    def _update(
        self, model: Model, step: Step, image_grads: dict, wanted: tuple[str, ...], ids: np.ndarray
    ) -> tuple[dict, int]:
        """Backward and Adam in one call of the library. A parameter is updated separately if its gradient is
        needed here: because a penalty is added to it, or because the gradient of the gates follows from it.
        Returns the gradients `wanted` and the number of rows that were not finite."""
        trained = PARAMETERS if step.slope is None else (*PARAMETERS, MASK)
        apart = (
            step.dense_gradients
            | {penalty.parameter for penalty in step.penalties}
            | ({"log_scales", MASK} if step.gates else set())
        )
        tensors = {
            _grad(name): (model.values[name], model.moments[name]) for name in trained if name not in apart
        }
        rates = {_grad(name): _row_rates(name, step.rates, model) for name in trained if name not in apart}
        slope = None if step.slope is None else np.asarray(step.slope, model.dtype)
        frozen = None if step.frozen is None else step.frozen.view(np.uint8)
        wanted = (*wanted, *(_grad(name) for name in trained if name in apart))
        settings = {"step": step.number, "betas": BETAS, "eps": EPS}
        grads, bad = self.rasterizer.backward_update(
            image_grads, tensors, rates, slope=slope, frozen=frozen, wanted=wanted, **settings
        )
        for name in trained:
            if name in apart:
                rows = mask_logit_rows(step, grads, ids) if name == MASK else grads[name]
                bad += self._step_rows(model, step, name, rows, ids)
        return grads, bad

    def _step_rows(self, model: Model, step: Step, name: str, rows: np.ndarray, ids: np.ndarray) -> int:
        """An Adam step on rows `ids` of one parameter, or on all rows if its gradient is dense. Returns the
        number of rows that were not finite."""
        added = [
            (penalty.seen, penalty.grad(values))
            for penalty, values in step.penalised(model.values, ids)
            if penalty.parameter == name
        ]
        for grad in (grad for seen, grad in added if seen):
            rows = rows + grad
        if name in step.dense_gradients:
            dense = np.zeros(model.values[name].shape, model.dtype)
            if name == MASK and step.lambda_m and step.masks is not None and step.slope is not None:
                dense += global_mask_grad(step.masks, step.slope, step.lambda_m)
            for grad in (grad for seen, grad in added if not seen):
                dense += grad
            dense[ids] += rows
            all_rows = None if step.frozen is None else np.flatnonzero(~step.frozen).astype(np.uint32)
            return self._adam(model, step, name, dense if all_rows is None else dense[all_rows], all_rows)
        return self._adam(model, step, name, rows, ids)

    def _adam(self, model: Model, step: Step, name: str, rows: np.ndarray, ids: np.ndarray | None) -> int:
        settings = {"lr": _row_rates(name, step.rates, model), "step": step.number}
        values, moments = model.values[name], model.moments[name]
        return self.rasterizer.adam(values, moments, rows, ids, **settings, betas=BETAS, eps=EPS)


def mask_logit_rows(step: Step, grads: dict[str, np.ndarray], ids: np.ndarray) -> np.ndarray:
    """dL/d(existence logit) of visible Gaussians, (V,). A gate's also comes from the scale (Compact3DGS)."""
    d_masks = grads["masks"] + grads["log_scales"].sum(axis=1) if step.gates else grads["masks"]
    assert step.slope is not None
    return d_masks * step.slope[ids]


def _grad(name: str) -> str:
    """The name of a parameter's gradient in the library."""
    return "masks" if name == MASK else name


def _row_rates(name: str, rates: dict[str, float], model: Model):
    """The learning rate of a parameter. For sh one rate per column: degrees above 0 have a smaller rate."""
    if name != "sh":
        return rates[name]
    columns = np.full(3 * model.sh.shape[1], rates["sh_rest"])
    columns[:3] = rates["sh"]
    return columns
