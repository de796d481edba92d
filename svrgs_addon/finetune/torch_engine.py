"""The torch engine: one optimisation step in PyTorch, term by term. The native engine (engine.py) is tested
against it.

Its tensors share memory with the model's arrays, and it stores moments in the same layout (moments.py). So
checkpoints, densification and pruning do not depend on the engine. To try a loss of your own, override
TorchEngine.loss.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ..native.library import GRADS
from ..native.rasterizer import Rasterizer
from ..scene.gaussians import PARAMETERS
from ..system.errors import SceneError
from .engine import BETAS, EPS, Step, StepResult
from .model import MASK, Model
from .moments import packed, unpacked

try:
    import torch
except ImportError:
    raise SceneError(
        "the torch engine needs PyTorch: install torch into this Python, or use --engine native"
    ) from None
from torch import Tensor
from torch.nn.functional import conv2d

WINDOW, SIGMA = 11, 1.5  # Gaussian window of SSIM, pixels
C1, C2 = 1e-4, 9e-4
SH = {"sh", "sh_rest"}


class Rasterize(torch.autograd.Function):
    """The native rasteriser as a differentiable function of N Gaussians. It returns one image per name in
    `outputs`.

    gaussians: tensors in the order of native.GRADS. Among them masks: (N,), 0 or 1, or None for all 1;
    means2d: (N, 2), which is not read and whose gradient is dL/d(projected centre), per pixel; camera:
    (N, 6), the same for the camera's motion. Call backward before the next forward of the rasteriser.
    """

    @staticmethod
    def forward(ctx, rasterizer: Rasterizer, step: Step, outputs: tuple[str, ...], *gaussians: Tensor | None):
        arrays: dict[str, Any] = {
            name: None if t is None else t.detach().numpy() for name, t in zip(GRADS, gaussians, strict=True)
        }
        masks = None if arrays["masks"] is None else arrays["masks"].astype(np.uint8)
        images = rasterizer.forward(SimpleNamespace(**arrays), step.camera, step.options, masks, outputs)
        ctx.rasterizer, ctx.outputs, ctx.count = rasterizer, outputs, len(arrays["means"])
        return tuple(torch.from_numpy(images[name]) for name in outputs)

    @staticmethod
    def backward(ctx, *image_grads: Tensor):
        wanted = [name for name, needed in zip(GRADS, ctx.needs_input_grad[3:], strict=True) if needed]
        given = {name: grad.contiguous().numpy() for name, grad in zip(ctx.outputs, image_grads, strict=True)}
        rows = ctx.rasterizer.backward(given, wanted)
        visible = _indices(ctx.rasterizer.visible())
        dense = (_scattered(rows[name], visible, ctx.count) if name in rows else None for name in GRADS)
        return None, None, None, *dense


def _indices(ids: np.ndarray) -> Tensor:
    """Rows as int64, with which torch indexes."""
    return torch.from_numpy(ids.astype(np.int64))


def _scattered(rows: np.ndarray, ids: Tensor, count: int) -> Tensor:
    """A tensor (count, ...) that holds `rows` at `ids` and 0 elsewhere."""
    dense = torch.zeros((count, *rows.shape[1:]), dtype=torch.from_numpy(rows).dtype)
    dense[ids] = torch.from_numpy(rows)
    return dense


def _local_mean(image: Tensor) -> Tensor:
    """Mean of (3, 1, H, W) under the Gaussian window of SSIM; pixels outside the image count as 0."""
    offsets = torch.arange(WINDOW, dtype=image.dtype) - WINDOW // 2
    taps = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    window = torch.outer(taps, taps) / taps.sum() ** 2
    return conv2d(image, window[None, None], padding=WINDOW // 2)


def ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean structural similarity (SSIM) of two images (H, W, 3), a scalar."""
    x, y = (image.permute(2, 0, 1)[:, None] for image in (x, y))
    mean_x, mean_y = _local_mean(x), _local_mean(y)
    variances = _local_mean(x * x) - mean_x**2 + _local_mean(y * y) - mean_y**2
    covariance = _local_mean(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return (luminance * (2 * covariance + C2) / (variances + C2)).mean()


def _masks(step: Step, leaves: dict[str, Tensor]) -> Tensor | None:
    """The masks of the step, (N,); None: all 1. Learned ones are straight-through: the value is the hard
    sample, the gradient that of the soft one (MaskGaussian)."""
    if step.masks is None:
        return None
    hard = torch.from_numpy(step.masks).to(leaves["means"].dtype)
    if step.slope is None:
        return hard
    return hard + torch.from_numpy(step.slope) * (leaves[MASK] - leaves[MASK].detach())


class TorchEngine:
    """Forward, loss, backward and Adam by torch. Afterwards the Gaussians that the view does not see get
    their old values back."""

    def __init__(self, level: str | None = None):
        self.rasterizer = Rasterizer(level)
        self.exposure: Tensor | None = None  # of the step that is being done

    def step(self, model: Model, step: Step) -> StepResult:
        leaves = _tensors(model.values)
        for leaf in leaves.values():
            leaf.requires_grad_()
        zeros = lambda width, wanted: torch.zeros(
            (model.count, width), dtype=leaves["means"].dtype, requires_grad=wanted
        )
        means2d, camera = zeros(2, step.want_means2d), zeros(6, step.want_camera)
        masks = _masks(step, leaves)
        self.exposure = None
        if step.exposure is not None:
            self.exposure = torch.tensor(step.exposure, dtype=leaves["means"].dtype, requires_grad=True)
        images = self._render(step, leaves, masks, means2d, camera)
        loss, l1, similarity, mask_loss = self.loss(step, images, masks)
        visible = step.not_frozen(self.rasterizer.visible())
        ids = _indices(visible)
        penalty = sum((p.value(rows, torch) for p, rows in step.penalised(leaves, ids)), torch.zeros(()))
        loss = loss + penalty
        loss.backward()
        result = StepResult(l1.item(), similarity.item(), mask_loss.item(), visible, penalty=penalty.item())
        if self.exposure is not None:
            result.exposure = _grad(self.exposure).numpy().astype(np.float64)
        if step.want_means2d:
            result.means2d = _grad(means2d)[ids].numpy()
        if step.want_camera:
            result.camera = _grad(camera)[ids].numpy().sum(axis=0, dtype=np.float64)
        if step.update:
            result.nonfinite = _update(model, step, leaves, ids)
        return result

    def loss(
        self, step: Step, images: dict[str, Tensor], masks: Tensor | None
    ) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """The loss without the penalty, and three of its terms: L1, SSIM and mean F^2 (SVR-GS Eq. 10).
        images: 'rgb' (H, W, 3) and, with a spatial mask, 'mask' (H, W). masks (N,) or None."""
        target = torch.tensor(step.target)  # a copy: photographs are read-only
        rgb = images["rgb"] if step.window is None else images["rgb"][step.window]
        if self.exposure is not None:
            valid = step.camera.valid
            rgb = rgb @ self.exposure[:, :3].T + self.exposure[:, 3]
            rgb = rgb if valid is None else rgb * torch.from_numpy(valid)[..., None]
        share = rgb.numel() / images["rgb"].numel()
        l1, similarity = share * (rgb - target).abs().mean(), 1 - share * (1 - ssim(rgb, target))
        total = step.l1_weight * l1 + step.ssim_weight * (1 - similarity)
        mask_loss = (images["mask"] ** 2).mean() if "mask" in images else torch.zeros(())
        if "mask" in images:
            total = total + step.lambda_f * mask_loss
        if masks is not None and step.lambda_m:
            total = total + step.lambda_m * masks.mean() ** 2
        return total, l1, similarity, mask_loss

    def _render(
        self, step: Step, leaves: dict[str, Tensor], masks: Tensor | None, means2d: Tensor, camera: Tensor
    ) -> dict[str, Tensor]:
        outputs = ("rgb", "mask") if step.spatial else ("rgb",)
        sh = torch.cat([leaves["sh"], leaves["sh_rest"]], dim=1)
        parameters = {name: sh if name == "sh" else leaves[name] for name in PARAMETERS}
        # the scale becomes g s, so log g is added; a closed gate is the mask 0, and its scale does not matter
        if step.gates and masks is not None:
            parameters["log_scales"] = (
                parameters["log_scales"] + torch.log(torch.where(masks.detach() > 0, masks, 1.0))[:, None]
            )
        images = Rasterize.apply(self.rasterizer, step, outputs, *parameters.values(), masks, means2d, camera)
        return dict(zip(outputs, images, strict=True))


def _grad(leaf: Tensor) -> Tensor:
    assert leaf.grad is not None
    return leaf.grad


def _tensors(arrays: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """Tensors on the arrays' memory. SH are split: degree 0 as 'sh', others as 'sh_rest'."""
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    return tensors | {"sh": tensors["sh"][:, :1], "sh_rest": tensors["sh"][:, 1:]}


def _update(model: Model, step: Step, leaves: dict[str, Tensor], ids: Tensor) -> int:
    """An Adam step on rows `ids`, in the model's memory. Returns the number of rows that were not finite."""
    learned = {name: leaf for name, leaf in leaves.items() if leaf.grad is not None}
    moments = {name: unpacked(array, model.values[name].shape) for name, array in model.moments.items()}
    optimizer = torch.optim.Adam(
        [{"params": [learned[name]], "lr": step.rates[name]} for name in learned.keys() - SH],
        betas=BETAS,
        eps=EPS,
    )
    for name in learned.keys() - SH:
        first, second = map(torch.from_numpy, moments[name])
        optimizer.state[learned[name]] = {
            "step": torch.tensor(step.number - 1.0),
            "exp_avg": first,
            "exp_avg_sq": second,
        }
    skipped, bad = _rows_left_alone(learned, step, ids)
    with torch.no_grad():
        saved = {name: leaf[skipped[name]] for name, leaf in learned.items()}
        optimizer.step()
        first, second = map(torch.from_numpy, moments["sh"])
        _step_sh(learned, first, second, step)
        for name, leaf in learned.items():
            leaf[skipped[name]] = saved[name]
    for name in learned.keys() - {"sh_rest"}:
        moved = ~skipped[name].numpy()
        model.moments[name][moved] = packed(*moments[name], step.number)[moved]
    return bad


def _step_sh(learned: dict[str, Tensor], first: Tensor, second: Tensor, step: Step):
    """Adam, in place, on SH, which share one second moment per Gaussian. first: (N, K, 3), second: (N,)."""
    grad = torch.cat([_grad(learned["sh"]), _grad(learned["sh_rest"])], dim=1)
    first.lerp_(grad, 1 - BETAS[0])
    second.lerp_((grad[:, 0] ** 2).mean(dim=1), 1 - BETAS[1])
    root = (second / (1 - BETAS[1] ** step.number)).sqrt() + EPS
    change = first / (1 - BETAS[0] ** step.number) / root[:, None, None]
    learned["sh"] -= step.rates["sh"] * change[:, :1]
    learned["sh_rest"] -= step.rates["sh_rest"] * change[:, 1:]


def _rows_left_alone(learned: dict[str, Tensor], step: Step, ids: Tensor) -> tuple[dict[str, Tensor], int]:
    """The rows that Adam must not change, (N,) bool by parameter name; and the number of rows that are not
    finite.

    A row is left alone if its gradient is not finite, if it is frozen, or if the view does not see it and the
    gradient of the parameter is sparse.
    """
    finite = {name: _grad(leaf)[:, None].flatten(1).isfinite().all(dim=1) for name, leaf in learned.items()}
    finite["sh"] = finite["sh_rest"] = finite["sh"] & finite["sh_rest"]
    seen = torch.zeros(len(finite["means"]), dtype=torch.bool)
    seen[ids] = True
    trained = torch.ones_like(seen) if step.frozen is None else ~torch.from_numpy(step.frozen)
    reached = {name: trained if name in step.dense_gradients else seen for name in learned}
    bad = sum(int((reached[name] & ~finite[name]).sum()) for name in learned if name != "sh_rest")
    return {name: ~(reached[name] & finite[name]) for name in learned}, bad
