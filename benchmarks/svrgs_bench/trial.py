"""One case at one SIMD level, to be run repeatedly. Every call does the same work."""

from __future__ import annotations

import numpy as np

from svrgs_addon.finetune.engine import NativeEngine, Step
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.native.rasterizer import RenderOptions, sample_masks
from svrgs_addon.scene.gaussians import PARAMETERS

from .cases import Case

MASK_LOGIT = 2.2  # existence logit: 9 of 10 Gaussians exist, so that mixed masks are measured
LAMBDA_F = 1e-4
SHIFT = 3  # pixels by which the target of the loss is shifted
RATE = 1e-13  # learning rate: so small that the scene does not change
WANTED = (*PARAMETERS, "masks")


def drawn_masks(count: int) -> tuple[np.ndarray, np.ndarray]:
    """(masks, slopes), (N,) each; always the same sample."""
    return sample_masks(np.full(count, MASK_LOGIT, np.float32), 0, 1)


def target_of(image: np.ndarray) -> np.ndarray:
    """The target of the loss for an image (H, W, 3): the image itself, shifted sideways."""
    return np.roll(image, SHIFT, axis=1)


class Trial:
    """A case at one level, with one method per stage of a fine-tuning step."""

    def __init__(self, case: Case, level: str | None = None):
        self.case = case
        self.engine = NativeEngine(level)
        self.rasterizer = self.engine.rasterizer
        self.model = Model.of(case.scene, self.rasterizer.dtype)
        self.model.add_masks(MASK_LOGIT)
        self.masks, self.slope = drawn_masks(case.scene.count)
        self.steps = 0
        self.images = self.forward()
        self.target = target_of(self.images["rgb"])
        self.image_grads = {
            "rgb": self.loss().copy(),
            "mask": self.rasterizer.mask_loss(self.images["mask"], LAMBDA_F)[1].copy(),
        }

    def options(
        self, mask_kind: str = "svr", full: bool = True, disabled_skips=(), sh_degree: int = 3
    ) -> RenderOptions:
        antialiased = self.case.scene.antialiased
        return RenderOptions(sh_degree, antialiased, full, mask_kind, disabled_skips=disabled_skips)

    def forward(
        self, mask_kind: str = "svr", full: bool = True, disabled_skips=(), sh_degree: int = 3
    ) -> dict[str, np.ndarray]:
        """Renders colours, and F unless mask_kind is 'none'."""
        outputs = ("rgb",) if mask_kind == "none" else ("rgb", "mask")
        options = self.options(mask_kind, full and mask_kind != "none", disabled_skips, sh_degree)
        return self.rasterizer.forward(self.model, self.case.camera, options, self.masks, outputs)

    def loss(self) -> np.ndarray:
        return self.rasterizer.loss(self.images["rgb"], self.target)[2]

    def backward(self, wanted=WANTED) -> dict[str, np.ndarray]:
        """Gradients of the last forward pass, one row per visible Gaussian."""
        return self.rasterizer.backward(self.image_grads, wanted)

    def adam(self, grads: dict[str, np.ndarray], ids: np.ndarray | None) -> float:
        """An Adam step on all parameters and existence logits of rows `ids` (None: all). Returns the seconds
        spent in the library."""
        self.steps += 1
        total = 0.0
        for name in (*PARAMETERS, MASK):
            grad = grads["masks" if name == MASK else name]
            self.rasterizer.adam(
                self.model.values[name], self.model.moments[name], grad, ids, lr=RATE, step=self.steps
            )
            total += self.rasterizer.stage_seconds()["adam"]
        return total

    def step(self, disabled_skips=()):
        """A whole fine-tuning step: forward, loss, backward and Adam."""
        self.steps += 1
        rates = dict.fromkeys((*PARAMETERS, "sh_rest", MASK), RATE)
        options = self.options(disabled_skips=disabled_skips)
        masks = {"masks": self.masks, "slope": self.slope, "lambda_f": LAMBDA_F}
        step = Step(self.case.camera, self.target, self.steps, rates, options, **masks)
        self.engine.step(self.model, step)
