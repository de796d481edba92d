"""Penalties on one parameter of all Gaussians, or of those that a view sees. The value is written once for
NumPy and torch; the gradient is analytic."""

from __future__ import annotations

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from .model import MASK

LOGIT_SHIFT = 20.0  # GNS pulls opacity logits towards -20
MIN_TRANSPARENCY = 0.05
RANK_EPS = 1e-7


class Penalty:
    """A term of the loss that depends on one parameter of the Gaussians."""

    parameter: ClassVar[str]  # a name in Model.values
    # it is given the rows of the Gaussians that the view sees, at least one; False: all rows
    seen: ClassVar[bool] = False

    def value(self, values, xp):
        """A scalar; values: the parameter (N, ...), an array of the module xp, numpy or torch."""
        raise NotImplementedError

    def grad(self, values: np.ndarray) -> np.ndarray:
        """The gradient of value(), in the shape and dtype of `values`."""
        raise NotImplementedError


@dataclass(frozen=True)
class MeanExistence(Penalty):
    """weight * mean sigmoid(m), m the existence logits (Compact3DGS, arXiv 2311.13681 section 3.1)."""

    weight: float
    parameter: ClassVar[str] = MASK

    def value(self, logits, xp):
        return self.weight * sigmoid(logits, xp).mean()

    def grad(self, logits: np.ndarray) -> np.ndarray:
        p = sigmoid(logits, np)
        return p * (1 - p) * logits.dtype.type(self.weight / len(logits))


@dataclass(frozen=True)
class MeanOpacity(MeanExistence):
    """weight * mean opacity (3DGS-MCMC, arXiv 2404.09591)."""

    parameter: ClassVar[str] = "opacity_logits"


@dataclass(frozen=True)
class MeanSeenOpacity(MeanOpacity):
    """weight * mean opacity of the Gaussians that the view sees (Reduced-3DGS, arXiv 2406.17074)."""

    seen: ClassVar[bool] = True


@dataclass(frozen=True)
class MeanScale(Penalty):
    """weight * mean scale, over all three axes (3DGS-MCMC, arXiv 2404.09591)."""

    weight: float
    parameter: ClassVar[str] = "log_scales"

    def value(self, log_scales, xp):
        return self.weight * xp.exp(log_scales).mean()

    def grad(self, log_scales: np.ndarray) -> np.ndarray:
        return np.exp(log_scales) * log_scales.dtype.type(self.weight / log_scales.size)


@dataclass(frozen=True)
class OpacityGoal(Penalty):
    """weight / 2 * sum of (opacity - goal)^2, with a goal (N,) for each Gaussian (ADMM of GaussianSpa, arXiv
    2411.06019)."""

    weight: float
    goal: np.ndarray
    parameter: ClassVar[str] = "opacity_logits"

    def value(self, logits, xp):
        return 0.5 * self.weight * ((sigmoid(logits, xp) - xp.asarray(self.goal)) ** 2).sum()

    def grad(self, logits: np.ndarray) -> np.ndarray:
        o = sigmoid(logits, np)
        return (self.weight * (o - self.goal) * o * (1 - o)).astype(logits.dtype, copy=False)


@dataclass(frozen=True)
class EffectiveRank(Penalty):
    """needle * mean max(-log(erank - 1 + 1e-7), 0) + thin * mean of the smallest scale (effective rank, arXiv
    2406.11672).

    erank = exp(-sum_k p_k log p_k) with p_k = scale_k^2 / (sum of the three squares) is between 1, a needle,
    and 3, a ball.
    """

    needle: float = 0.01
    thin: float = 1.0
    parameter: ClassVar[str] = "log_scales"

    def value(self, log_scales, xp):
        _, entropy, smallest = self._shape(log_scales, xp)
        needles = xp.clip(-xp.log(xp.expm1(entropy) + RANK_EPS), 0.0, None).mean()
        return self.needle * needles + self.thin * xp.exp(smallest).mean()

    def grad(self, log_scales: np.ndarray) -> np.ndarray:
        shares, entropy, smallest = self._shape(log_scales, np)
        above = np.expm1(entropy) + RANK_EPS
        slope = np.where(above < 1, -2 * self.needle * np.exp(entropy) / above, 0)
        grad = np.stack([slope * p * (-log_p - entropy) for p, log_p in shares], axis=1)
        grad[np.arange(len(grad)), log_scales.argmin(axis=1)] += self.thin * np.exp(smallest)
        return (grad / len(grad)).astype(log_scales.dtype, copy=False)

    @staticmethod
    def _shape(log_scales, xp):
        """[(p_k, log p_k)] of three axes, the entropy -sum p log p, the smallest log-scale; (N,) each."""
        a, b, c = log_scales.T
        largest, smallest = xp.maximum(xp.maximum(a, b), c), xp.minimum(xp.minimum(a, b), c)
        # log of the squares, relative to the largest: no square underflows or overflows
        gaps = [2 * (x - largest) for x in (a, b, c)]
        log_total = xp.log(sum(xp.exp(gap) for gap in gaps))
        shares = [(xp.exp(gap - log_total), gap - log_total) for gap in gaps]
        return shares, -sum(p * log_p for p, log_p in shares), smallest


@dataclass(frozen=True)
class OpacityPressure(Penalty):
    """The pressure on opacity logits l, in the two forms of GNS (arXiv 2511.16980):

    weight * (mean_i (l_i + 20) / max(0.05, 1 - opacity_i))^2      by_transparency
    weight * (mean_i (l_i + 20))^2                                 otherwise
    """

    weight: float
    by_transparency: bool
    parameter: ClassVar[str] = "opacity_logits"

    def value(self, logits, xp):
        excess = logits + LOGIT_SHIFT
        if self.by_transparency:
            excess = excess / xp.clip(1 - sigmoid(logits, xp), MIN_TRANSPARENCY, None)
        return self.weight * excess.mean() ** 2

    def grad(self, logits: np.ndarray) -> np.ndarray:
        excess, slopes = logits + LOGIT_SHIFT, np.ones_like(logits)
        if self.by_transparency:
            o = sigmoid(logits, np)
            transparency = np.maximum(1 - o, logits.dtype.type(MIN_TRANSPARENCY))
            free = 1 - o > MIN_TRANSPARENCY
            slopes = 1 / transparency + np.where(free, excess * o * (1 - o) / transparency**2, 0)
            excess = excess / transparency
        slopes = slopes * (2 * self.weight * float(excess.mean()) / len(logits))
        return slopes.astype(logits.dtype, copy=False)


def sigmoid(x, xp):
    return 1 / (1 + xp.exp(-xp.clip(x, -80.0, 80.0)))
