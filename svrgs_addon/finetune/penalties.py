"""Penalties on one parameter of all Gaussians, visible or not. The value is written once for NumPy and torch; the gradient is analytic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar, Protocol

import numpy as np

from .model import MASK

LOGIT_SHIFT = 20.0  # GNS pulls opacity logits towards -20
MIN_TRANSPARENCY = 0.05


class Penalty(Protocol):
    """A term of the loss that depends on one parameter of all Gaussians."""

    parameter: ClassVar[str]  # a name in Model.values

    def value(self, values, xp):
        """A scalar; values: the parameter (N, ...), an array of the module xp, numpy or torch."""

    def grad(self, values: np.ndarray) -> np.ndarray:
        """The gradient of value(), in the shape and dtype of `values`."""


@dataclass(frozen=True)
class MeanExistence:
    """weight * mean sigmoid(m), where m are the existence logits (Compact3DGS, arXiv 2311.13681 section 3.1)."""

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
class MeanOpacity(MeanExistence):
    """weight * mean opacity (3DGS-MCMC, arXiv 2404.09591)."""

    parameter: ClassVar[str] = "opacity_logits"


@dataclass(frozen=True)
class MeanScale:
    """weight * mean scale, over all three axes (3DGS-MCMC, arXiv 2404.09591)."""

    weight: float
    parameter: ClassVar[str] = "log_scales"

    def value(self, log_scales, xp):
        return self.weight * xp.exp(log_scales).mean()

    def grad(self, log_scales: np.ndarray) -> np.ndarray:
        return np.exp(log_scales) * log_scales.dtype.type(self.weight / log_scales.size)


@dataclass(frozen=True)
class OpacityPressure:
    """The pressure on opacity logits l, in the two forms of GNS (arXiv 2511.16980), with a weight s_i per Gaussian:

        weight * (mean_i s_i (l_i + 20) / max(0.05, 1 - opacity_i))^2      by_transparency
        weight * (mean_i s_i (l_i + 20))^2                                 otherwise

    gaussian_weights: s (N,), 1 on average; None: all 1.
    """

    weight: float
    by_transparency: bool
    gaussian_weights: np.ndarray | None = None
    parameter: ClassVar[str] = "opacity_logits"

    def value(self, logits, xp):
        """A scalar; logits (N,) an array of the module xp, numpy or torch."""
        excess = logits + LOGIT_SHIFT
        if self.by_transparency:
            excess = excess / xp.clip(1 - sigmoid(logits, xp), MIN_TRANSPARENCY, None)
        if self.gaussian_weights is not None:
            excess = excess * xp.asarray(self.gaussian_weights)
        return self.weight * excess.mean() ** 2

    def grad(self, logits: np.ndarray) -> np.ndarray:
        """(N,) in the logits' dtype."""
        excess, slopes = logits + LOGIT_SHIFT, np.ones_like(logits)
        if self.by_transparency:
            o = sigmoid(logits, np)
            transparency = np.maximum(1 - o, logits.dtype.type(MIN_TRANSPARENCY))
            slopes = 1 / transparency + np.where(1 - o > MIN_TRANSPARENCY, excess * o * (1 - o) / transparency**2, 0)
            excess = excess / transparency
        if self.gaussian_weights is not None:
            excess, slopes = excess * self.gaussian_weights, slopes * self.gaussian_weights
        return (slopes * (2 * self.weight * float(excess.mean()) / len(logits))).astype(logits.dtype, copy=False)


def sigmoid(x, xp):
    return 1 / (1 + xp.exp(-xp.clip(x, -80.0, 80.0)))
