"""The native engine: one optimisation step with NumPy arrays and the native kernels, nothing else.

An engine is anything with `step(model, step) -> StepResult`; torch_engine.py is the readable twin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..camera import Camera
from ..native import Rasterizer, RenderOptions
from .model import MASK, PARAMETERS, Model
from .penalties import MeanExistence, OpacityPressure

BETAS, EPS = (0.9, 0.999), 1e-15


@dataclass
class Step:
    """What one step looks at and by which rules."""

    camera: Camera
    target: np.ndarray  # (H, W, 3) in the model's dtype, display sRGB 0..1
    number: int  # counts from 1 over the run; Adam's t
    rates: dict[str, float]
    options: RenderOptions
    l1_weight: float = 0.8
    ssim_weight: float = 0.2
    masks: np.ndarray | None = None  # (N,) uint8, this step's draw
    slope: np.ndarray | None = None  # (N,) dM/dlogit; None: masks are not learned
    lambda_f: float = 0.0
    lambda_m: float = 0.0
    gates: bool = False  # masks multiply scale too (Compact3DGS), and learn only while open
    penalty: MeanExistence | OpacityPressure | None = None
    update: bool = True  # False: gradients only (3DGS takes no optimiser step where it densifies)
    want_means2d: bool = False

    @property
    def spatial(self) -> bool:
        """Whether F is rendered and penalised."""
        return self.lambda_f > 0 and self.masks is not None

    @property
    def global_loss(self) -> float:
        """(mean M)^2 (MaskGaussian)."""
        return float(self.masks.mean()) ** 2 if self.masks is not None else 0.0

    @property
    def reaching_all(self) -> set[str]:
        """Parameters with a gradient on every Gaussian, seen or not."""
        return ({MASK} if self.lambda_m else set()) | ({self.penalty.parameter} if self.penalty else set())


@dataclass
class StepResult:
    """Loss terms before the step, and what densification wants to know."""

    l1: float
    ssim: float
    mask_loss: float  # mean F^2
    visible: np.ndarray  # (V,) uint32
    means2d: np.ndarray | None = None  # (V, 2) dL/d(projected centre), pixels
    global_loss: float = 0.0  # (mean M)^2
    penalty: float = 0.0  # weighted
    nonfinite: int = 0  # rows skipped because their gradient was not finite

    def image_loss(self, step: Step) -> float:
        return step.l1_weight * self.l1 + step.ssim_weight * (1 - self.ssim)

    def loss(self, step: Step) -> float:
        return self.image_loss(step) + step.lambda_f * self.mask_loss + step.lambda_m * self.global_loss + self.penalty


def mask_loss_grad(mask: np.ndarray, weight: float) -> tuple[float, np.ndarray]:
    """mean F^2 (paper Eq. 10) and weight * its gradient; mask: F (H, W)."""
    flat = mask.ravel()
    return float(np.dot(flat, flat)) / flat.size, mask * mask.dtype.type(2 * weight / flat.size)


def global_mask_grad(masks: np.ndarray, slope: np.ndarray, lambda_m: float) -> np.ndarray:
    """d/dlogits of lambda_m (mean M)^2 (MaskGaussian), (N,)."""
    return slope * slope.dtype.type(2 * lambda_m * float(masks.mean()) / len(masks))


class NativeEngine:
    """Forward, loss, backward and a sparse Adam step: only Gaussians this view saw are touched."""

    def __init__(self, level: str | None = None):
        self.rasterizer = Rasterizer(level)

    def step(self, model: Model, step: Step) -> StepResult:
        r = self.rasterizer
        outputs = ("rgb", "mask") if step.spatial else ("rgb",)
        images = r.forward(model, step.camera, step.options, step.masks, outputs)
        l1, ssim, d_rgb = r.loss(images["rgb"], step.target, step.l1_weight, step.ssim_weight)
        image_grads, mask_loss = {"rgb": d_rgb}, 0.0
        if step.spatial:
            mask_loss, image_grads["mask"] = mask_loss_grad(images["mask"], step.lambda_f)
        result = StepResult(l1, ssim, mask_loss, r.visible(), global_loss=step.global_loss)
        if step.penalty:
            result.penalty = float(step.penalty.value(model.values[step.penalty.parameter], np))
        wanted: tuple[str, ...] = ("means2d",) if step.want_means2d else ()
        if not step.update:
            result.means2d = r.backward(image_grads, wanted).get("means2d")
            return result
        if step.slope is not None:
            wanted += ("masks",)
        grads, result.nonfinite = self._update(model, step, image_grads, wanted, result.visible)
        result.means2d = grads.get("means2d")
        if step.slope is not None:
            result.nonfinite += self._step_rows(model, step, MASK, mask_logit_rows(step, grads, result.visible), result.visible)
        return result

    def _update(self, model: Model, step: Step, image_grads: dict, wanted: tuple[str, ...], ids: np.ndarray) -> tuple[dict, int]:
        """Gradients into an Adam step at once, but for those that something is added to, or that others follow from."""
        apart = [name for name in PARAMETERS if name in step.reaching_all or name == "log_scales" and step.gates]
        at_once = [name for name in PARAMETERS if name not in apart]
        tensors = {name: (model.values[name], model.moments[name]) for name in at_once}
        rates = {name: _row_rates(name, step.rates, model) for name in at_once}
        update = self.rasterizer.backward_update
        grads, bad = update(image_grads, tensors, rates, step=step.number, betas=BETAS, eps=EPS, wanted=(*wanted, *apart))
        return grads, bad + sum(self._step_rows(model, step, name, grads[name], ids) for name in apart)

    def _step_rows(self, model: Model, step: Step, name: str, rows: np.ndarray, ids: np.ndarray) -> int:
        """Adam on one parameter's rows `ids`, or on all rows where something reaches all."""
        if name in step.reaching_all:
            dense = np.zeros(model.values[name].shape, model.dtype)
            if name == MASK and step.lambda_m and step.masks is not None and step.slope is not None:
                dense += global_mask_grad(step.masks, step.slope, step.lambda_m)
            if step.penalty and step.penalty.parameter == name:
                dense += step.penalty.grad(model.values[name])
            dense[ids] += rows
            return self._adam(model, step, name, dense, None)
        return self._adam(model, step, name, rows, ids)

    def _adam(self, model: Model, step: Step, name: str, rows: np.ndarray, ids: np.ndarray | None) -> int:
        rates = _row_rates(name, step.rates, model)
        return self.rasterizer.adam(model.values[name], model.moments[name], rows, ids, lr=rates, step=step.number, betas=BETAS, eps=EPS)


def mask_logit_rows(step: Step, grads: dict[str, np.ndarray], ids: np.ndarray) -> np.ndarray:
    """dL/dlogit (V,) of the visible Gaussians' masks; a gate's comes from scale as well (methods/compact3dgs.py)."""
    d_masks = grads["masks"] + grads["log_scales"].sum(axis=1) if step.gates else grads["masks"]
    assert step.slope is not None
    return d_masks * step.slope[ids]


def _row_rates(name: str, rates: dict[str, float], model: Model):
    """The rate of a tensor, or one per column: SH above degree 0 learns more slowly."""
    if name != "sh":
        return rates[name]
    columns = np.full(3 * model.sh.shape[1], rates["sh_rest"])
    columns[:3] = rates["sh"]
    return columns
