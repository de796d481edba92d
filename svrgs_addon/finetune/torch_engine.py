"""The torch engine: one optimisation step in torch, term by term; the readable twin of engine.py and its oracle.

Its parameters share memory with the model's, and the moments are packed as there, so checkpoints, densification and pruning work the same after either
engine. For a loss of your own, override TorchEngine.loss.
"""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np

from ..errors import SceneError
from ..native import GRADS, Rasterizer
from .engine import BETAS, EPS, Step, StepResult
from .model import MASK, PARAMETERS, Model
from .moments import packed, unpacked

try:
    import torch
except ImportError:
    raise SceneError("the torch engine needs PyTorch: install torch into this Python, or use --engine native") from None
from torch import Tensor
from torch.nn.functional import conv2d

WINDOW, SIGMA = 11, 1.5  # of SSIM, pixels
C1, C2 = 1e-4, 9e-4
SH = {"sh", "sh_rest"}


class Rasterize(torch.autograd.Function):
    """The native rasteriser as a differentiable function of N Gaussians: one image for each name in `outputs`.

    gaussians: tensors in the order of native.GRADS. masks: (N,) 0 or 1, or None for all 1; means2d: (N, 2), not read,
    its gradient is dL/d(projected centre) in pixels. Call backward before the rasteriser's next forward.
    """

    @staticmethod
    def forward(ctx, rasterizer: Rasterizer, step: Step, outputs: tuple[str, ...], *gaussians: Tensor | None):
        arrays: dict[str, Any] = {name: None if t is None else t.detach().numpy() for name, t in zip(GRADS, gaussians, strict=True)}
        masks = None if arrays["masks"] is None else arrays["masks"].astype(np.uint8)
        images = rasterizer.forward(SimpleNamespace(**arrays), step.camera, step.options, masks, outputs)
        ctx.rasterizer, ctx.outputs, ctx.count = rasterizer, outputs, len(arrays["means"])
        return tuple(torch.from_numpy(images[name]) for name in outputs)

    @staticmethod
    def backward(ctx, *image_grads: Tensor):
        wanted = [name for name, needed in zip(GRADS, ctx.needs_input_grad[3:], strict=True) if needed]
        given = {name: grad.contiguous().numpy() for name, grad in zip(ctx.outputs, image_grads, strict=True)}
        rows = ctx.rasterizer.backward(given, wanted)
        visible = row_ids(ctx.rasterizer)
        dense = (_scattered(rows[name], visible, ctx.count) if name in rows else None for name in GRADS)
        return None, None, None, *dense


def row_ids(rasterizer: Rasterizer) -> Tensor:
    """Ids of the Gaussians the last view saw, (V,) int64."""
    return torch.from_numpy(rasterizer.visible().astype(np.int64))


def _scattered(rows: np.ndarray, ids: Tensor, count: int) -> Tensor:
    """(count, ...) zeros but for the given rows."""
    dense = torch.zeros((count, *rows.shape[1:]), dtype=torch.from_numpy(rows).dtype)
    dense[ids] = torch.from_numpy(rows)
    return dense


def _local_mean(image: Tensor) -> Tensor:
    """(3, 1, H, W) averaged by the Gaussian window of SSIM; zeros outside the image."""
    offsets = torch.arange(WINDOW, dtype=image.dtype) - WINDOW // 2
    taps = torch.exp(-0.5 * (offsets / SIGMA) ** 2)
    window = torch.outer(taps, taps) / taps.sum() ** 2
    return conv2d(image, window[None, None], padding=WINDOW // 2)


def ssim(x: Tensor, y: Tensor) -> Tensor:
    """Mean structural similarity of two (H, W, 3) images, a scalar."""
    x, y = (image.permute(2, 0, 1)[:, None] for image in (x, y))
    mean_x, mean_y = _local_mean(x), _local_mean(y)
    variances = _local_mean(x * x) - mean_x**2 + _local_mean(y * y) - mean_y**2
    covariance = _local_mean(x * y) - mean_x * mean_y
    luminance = (2 * mean_x * mean_y + C1) / (mean_x**2 + mean_y**2 + C1)
    return (luminance * (2 * covariance + C2) / (variances + C2)).mean()


def straight_through(step: Step, logits: Tensor) -> Tensor:
    """This step's masks (N,): the hard draw in value, the soft sample in gradient (MaskGaussian)."""
    hard, slope = torch.from_numpy(step.masks).to(logits.dtype), torch.from_numpy(step.slope)
    return hard + slope * (logits - logits.detach())


def _masks(step: Step, leaves: dict[str, Tensor]) -> Tensor | None:
    """This step's masks (N,), learned or given."""
    if step.masks is None:
        return None
    return torch.from_numpy(step.masks).to(leaves["means"].dtype) if step.slope is None else straight_through(step, leaves[MASK])


class TorchEngine:
    """Forward, loss, backward and Adam by torch; then Gaussians this view did not see are put back as they were."""

    def __init__(self, level: str | None = None):
        self.rasterizer = Rasterizer(level)

    def step(self, model: Model, step: Step) -> StepResult:
        leaves = _tensors(model.values)
        for leaf in leaves.values():
            leaf.requires_grad_()
        means2d = torch.zeros((model.count, 2), dtype=leaves["means"].dtype, requires_grad=step.want_means2d)
        masks = _masks(step, leaves)
        images = self._render(step, leaves, masks, means2d)
        loss, l1, similarity, mask_loss = self.loss(step, images, masks)
        penalty = step.penalty.value(leaves[step.penalty.parameter], torch) if step.penalty else torch.zeros(())
        loss = loss + penalty
        loss.backward()
        ids = row_ids(self.rasterizer)
        result = StepResult(l1.item(), similarity.item(), mask_loss.item(), self.rasterizer.visible(), global_loss=step.global_loss)
        result.penalty = penalty.item()
        if step.want_means2d:
            result.means2d = _grad(means2d)[ids].numpy()
        if step.update:
            result.nonfinite = _update(model, step, leaves, ids)
        return result

    def loss(self, step: Step, images: dict[str, Tensor], masks: Tensor | None) -> tuple[Tensor, Tensor, Tensor, Tensor]:
        """What is minimised, and three of its terms: L1, SSIM, mean F^2 (paper Eq. 10). images: 'rgb' and, with a spatial mask, 'mask'."""
        target = torch.tensor(step.target)  # a copy: photographs are read-only
        l1, similarity = (images["rgb"] - target).abs().mean(), ssim(images["rgb"], target)
        total = step.l1_weight * l1 + step.ssim_weight * (1 - similarity)
        mask_loss = (images["mask"] ** 2).mean() if "mask" in images else torch.zeros(())
        if "mask" in images:
            total = total + step.lambda_f * mask_loss
        if masks is not None and step.lambda_m:
            total = total + step.lambda_m * masks.mean() ** 2
        return total, l1, similarity, mask_loss

    def _render(self, step: Step, leaves: dict[str, Tensor], masks: Tensor | None, means2d: Tensor) -> dict[str, Tensor]:
        outputs = ("rgb", "mask") if step.spatial else ("rgb",)
        sh = torch.cat([leaves["sh"], leaves["sh_rest"]], dim=1)
        parameters = {name: sh if name == "sh" else leaves[name] for name in PARAMETERS}
        if step.gates and masks is not None:  # g s, in logarithms; a closed gate is the mask 0, whatever the scale
            parameters["log_scales"] = parameters["log_scales"] + torch.log(torch.where(masks.detach() > 0, masks, 1.0))[:, None]
        images = Rasterize.apply(self.rasterizer, step, outputs, *parameters.values(), masks, means2d)
        return dict(zip(outputs, images, strict=True))


def _grad(leaf: Tensor) -> Tensor:
    assert leaf.grad is not None
    return leaf.grad


def _tensors(arrays: dict[str, np.ndarray]) -> dict[str, Tensor]:
    """The arrays as tensors on the same memory, SH in two: degree 0 as 'sh', the others as 'sh_rest'."""
    tensors = {name: torch.from_numpy(array) for name, array in arrays.items()}
    return tensors | {"sh": tensors["sh"][:, :1], "sh_rest": tensors["sh"][:, 1:]}


def _update(model: Model, step: Step, leaves: dict[str, Tensor], ids: Tensor) -> int:
    """One Adam step on the rows `ids`, in the model's memory. Returns how many rows were left out because not finite."""
    learned = {name: leaf for name, leaf in leaves.items() if leaf.grad is not None}
    moments = {name: unpacked(array, model.values[name].shape) for name, array in model.moments.items()}
    optimizer = torch.optim.Adam([{"params": [learned[name]], "lr": step.rates[name]} for name in learned.keys() - SH], betas=BETAS, eps=EPS)
    for name in learned.keys() - SH:
        first, second = map(torch.from_numpy, moments[name])
        optimizer.state[learned[name]] = {"step": torch.tensor(step.number - 1.0), "exp_avg": first, "exp_avg_sq": second}
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
    """Adam on SH coefficients, which share one second moment a Gaussian (moments.py). first (N, K, 3) and second (N,) become the next ones."""
    grad = torch.cat([_grad(learned["sh"]), _grad(learned["sh_rest"])], dim=1)
    first.lerp_(grad, 1 - BETAS[0])
    second.lerp_((grad[:, 0] ** 2).mean(dim=1), 1 - BETAS[1])
    root = (second / (1 - BETAS[1] ** step.number)).sqrt() + EPS
    change = first / (1 - BETAS[0] ** step.number) / root[:, None, None]
    learned["sh"] -= step.rates["sh"] * change[:, :1]
    learned["sh_rest"] -= step.rates["sh_rest"] * change[:, 1:]


def _rows_left_alone(learned: dict[str, Tensor], step: Step, ids: Tensor) -> tuple[dict[str, Tensor], int]:
    """By name, the rows (N,) bool that Adam must not change: not seen, or not finite; and the number of the latter.

    What reaches all Gaussians changes those too that are not seen.
    """
    finite = {name: _grad(leaf)[:, None].flatten(1).isfinite().all(dim=1) for name, leaf in learned.items()}
    finite["sh"] = finite["sh_rest"] = finite["sh"] & finite["sh_rest"]
    seen = torch.zeros(len(finite["means"]), dtype=torch.bool)
    seen[ids] = True
    reached = {name: torch.ones_like(seen) if name in step.reaching_all else seen for name in learned}
    bad = sum(int((reached[name] & ~finite[name]).sum()) for name in learned if name != "sh_rest")
    return {name: ~(reached[name] & finite[name]) for name in learned}, bad
