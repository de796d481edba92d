"""Adam with packed moments against Adam in float64, over the range of gradients: where 30,000 steps end.

    .venv/bin/python benchmarks/moments.py

A line for each magnitude of the gradients and each kind of Gaussian: seen in every step; idle, seen in one of
100; placed anew at times, as MCMC does, with moments of 0. Values and SH coefficients are packed differently.
Each figure is the distance between the ends over the way that the float64 run went, in the mean of 64
Gaussians; beside it the same of float32 moments that are not packed.
"""

from __future__ import annotations

import numpy as np

from svrgs_addon.finetune.moments import zero_moments
from svrgs_addon.native.library import best_level
from svrgs_addon.native.rasterizer import Rasterizer

STEPS, ROWS, RATE, PLACED_EVERY, IDLE = 30_000, 64, 1e-3, 3_000, 100
MAGNITUDES = 10.0 ** np.array([-30, -20, -18, -15, -10, -5, 0, 5, 10, 15, 18])
KINDS = {"seen": 1, "idle": IDLE, "placed anew": 1}
BETAS, EPS = (0.9, 0.999), 1e-15


class Plain:
    """Adam as in the paper, with moments of a dtype. SH coefficients (N, K, 3) share v of degree 0."""

    def __init__(self, start: np.ndarray, dtype: type):
        self.param = start.astype(dtype)
        self.clear()

    def clear(self):
        self.m = np.zeros_like(self.param)
        self.v = np.zeros_like(self.param[:, :1, :1] if self.param.ndim == 3 else self.param)

    def step(self, grad: np.ndarray, number: int):
        grad = grad.astype(self.param.dtype)
        square = (grad[:, :1] ** 2).mean(axis=2, keepdims=True) if grad.ndim == 3 else grad**2
        one = self.param.dtype.type
        self.m = one(BETAS[0]) * self.m + one(1 - BETAS[0]) * grad
        self.v = one(BETAS[1]) * self.v + one(1 - BETAS[1]) * square
        root = np.sqrt(self.v / one(1 - BETAS[1] ** number)) + one(EPS)
        self.param -= one(RATE) * (self.m / one(1 - BETAS[0] ** number)) / root


class Packed(Plain):
    """The native Adam."""

    def __init__(self, start: np.ndarray, dtype: type):
        self.rasterizer = Rasterizer(best_level())
        super().__init__(start, dtype)

    def clear(self):
        self.moments = zero_moments(self.param)

    def step(self, grad: np.ndarray, number: int):
        self.rasterizer.adam(
            self.param,
            self.moments,
            grad.astype(np.float32),
            None,
            lr=RATE,
            step=number,
            betas=BETAS,
            eps=EPS,
        )


def ends(kind: str, shape: tuple) -> np.ndarray:
    """Distances from the float64 run over its way, (2, magnitudes): packed, and plain float32."""
    rng = np.random.default_rng(0)
    scale = np.repeat(MAGNITUDES, ROWS).reshape(-1, *[1] * (len(shape) - 1))
    start = np.zeros(shape)
    exact, runs = Plain(start, np.float64), [Packed(start, np.float32), Plain(start, np.float32)]
    pull = rng.normal(0, 0.1, shape)  # what a gradient is in the mean
    for number in range(1, STEPS + 1):
        grad = (scale * (pull + rng.normal(size=shape))).astype(np.float32)
        for run in (exact, *runs):
            if kind == "placed anew" and number % PLACED_EVERY == 0:
                run.clear()
            if number % KINDS[kind] == 0:
                run.step(grad, number)
    groups = lambda array: array.astype(np.float64).reshape(len(MAGNITUDES), -1)
    way = np.linalg.norm(groups(exact.param), axis=1)
    return np.array([np.linalg.norm(groups(run.param) - groups(exact.param), axis=1) for run in runs]) / way


def main():
    count = len(MAGNITUDES) * ROWS
    print(
        "| gradients of about | "
        + " | ".join(f"{kind}, {what}" for kind in KINDS for what in ("values", "SH"))
    )
    print("|---" * (1 + 2 * len(KINDS)) + "|")
    with np.errstate(all="ignore"):
        found = [ends(kind, shape) for kind in KINDS for shape in ((count, 3), (count, 4, 3))]
    for k, magnitude in enumerate(MAGNITUDES):
        cells = (f"{packed[k]:.1e} ({plain[k]:.1e})" for packed, plain in found)
        print(f"| {magnitude:.0e} | {' | '.join(cells)} |")


if __name__ == "__main__":
    main()
