"""Penalties on one parameter of every Gaussian, seen or not: a value that NumPy and torch compute alike, and its gradient."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .model import MASK

LOGIT_SHIFT = 20.0  # GNS pulls logits towards minus this
MIN_FAINTNESS = 0.05


@dataclass(frozen=True)
class MeanExistence:
    """weight * mean sigmoid(m): Compact3DGS section 3.1, m the mask logits."""

    weight: float
    parameter: ClassVar[str] = MASK

    def value(self, logits, xp):
        """A scalar; logits (N,) an array of the module xp, numpy or torch."""
        return self.weight * sigmoid(logits, xp).mean()

    def grad(self, logits: np.ndarray) -> np.ndarray:
        """(N,) in the logits' dtype."""
        p = sigmoid(logits, np)
        return p * (1 - p) * logits.dtype.type(self.weight / len(logits))


@dataclass(frozen=True)
class OpacityPressure:
    """weight * (mean (l + 20))^2 on the opacity logits l, every Gaussian's share divided by max(0.05, 1 - opacity) where
    `by_faintness`: the two forms of GNS (arXiv 2511.16980). shares (N,): what each Gaussian's counts, 1 on average; None: alike."""

    weight: float
    by_faintness: bool
    shares: np.ndarray | None = None
    parameter: ClassVar[str] = "opacity_logits"

    def value(self, logits, xp):
        """A scalar; logits (N,) an array of the module xp, numpy or torch."""
        excess = logits + LOGIT_SHIFT
        if self.by_faintness:
            excess = excess / xp.clip(1 - sigmoid(logits, xp), MIN_FAINTNESS, None)
        if self.shares is not None:
            excess = excess * xp.asarray(self.shares)
        return self.weight * excess.mean() ** 2

    def grad(self, logits: np.ndarray) -> np.ndarray:
        """(N,) in the logits' dtype."""
        excess, slopes = logits + LOGIT_SHIFT, np.ones_like(logits)
        if self.by_faintness:
            o = sigmoid(logits, np)
            faintness = np.maximum(1 - o, logits.dtype.type(MIN_FAINTNESS))
            slopes = 1 / faintness + np.where(1 - o > MIN_FAINTNESS, excess * o * (1 - o) / faintness**2, 0)
            excess = excess / faintness
        if self.shares is not None:
            excess, slopes = excess * self.shares, slopes * self.shares
        return (slopes * (2 * self.weight * float(excess.mean()) / len(logits))).astype(logits.dtype, copy=False)


def sigmoid(x, xp):
    return 1 / (1 + xp.exp(-xp.clip(x, -80.0, 80.0)))
