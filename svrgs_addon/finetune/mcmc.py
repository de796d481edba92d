"""Densification of 3DGS-MCMC (Kheradmand et al. 2024, arXiv 2404.09591): nothing is cloned, split or removed,
and opacities are never reset.

Instead of being removed, a Gaussian whose opacity is at most 0.005 moves onto another one. Until the cap is
reached, more Gaussians are added in the same way. Those that share a place get opacities and scales with
which they look like the one before. In every step noise moves the Gaussians of low opacity, and two penalties
lower opacities and scales.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from ..scene.rotations import rotated
from .model import Model
from .penalties import MeanOpacity, MeanScale, sigmoid
from .settings import MCMC

MAX_SHARING = 50  # Gaussians that share a place, in the formula for their opacity and scale
GATE, STEEPNESS = 0.995, 100.0  # noise is multiplied by sigmoid(STEEPNESS (1 - opacity - GATE))
NEGLIGIBLE = 1e-5  # noise that is smaller than this share of the Gaussian's largest scale is left out


def densify(model: Model, rule: MCMC, rng: Generator, fits: Callable[[int], bool] = lambda _: True) -> int:
    """Relocates the dead Gaussians and adds new ones. fits(n): whether memory holds n more Gaussians; if not,
    none is added. Returns the number of rows that moved or are new."""
    return _relocate(model, rule, rng) + _grow(model, rule, rng, fits)


def _relocate(model: Model, rule: MCMC, rng: Generator) -> int:
    opacity = _opacities(model)
    dead, alive = np.flatnonzero(opacity <= rule.min_opacity), np.flatnonzero(opacity > rule.min_opacity)
    if not len(dead) or not len(alive):
        return 0
    chosen = rng.choice(alive, len(dead), p=opacity[alive] / opacity[alive].sum())
    _share(model, rule, chosen)
    for array in model.values.values():
        array[dead] = array[chosen]
    return len(dead)


def _grow(model: Model, rule: MCMC, rng: Generator, fits: Callable[[int], bool]) -> int:
    added = min(rule.cap, int(rule.growth * model.count)) - model.count
    if added <= 0 or not fits(added):
        return 0
    opacity = _opacities(model)
    chosen = rng.choice(model.count, added, p=opacity / opacity.sum())
    _share(model, rule, chosen)
    model.append({name: array[chosen] for name, array in model.values.items()})
    return added


def _share(model: Model, rule: MCMC, chosen: np.ndarray):
    """Gives the Gaussians `chosen` the opacities and scales that let each of their copies have a share.
    chosen: rows, once for each copy."""
    rows, copies = np.unique(chosen, return_counts=True)
    opacity, scale = shares(_opacities(model)[rows], copies + 1)
    opacity = np.clip(opacity, rule.min_opacity, 1 - np.finfo(np.float32).eps)
    model.opacity_logits[rows] = np.log(opacity / (1 - opacity))
    model.log_scales[rows] += np.log(scale)[:, None].astype(model.dtype)
    for array in model.moments.values():
        array[rows] = 0


def shares(opacity: np.ndarray, count: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The opacity of each of `count` Gaussians that replace one, and the factor on its scales, (N,) each (Eq.
    9 of the paper).

    opacity (N,) of the one, float64; count (N,), of at least 1. The published double sum is over i up to the
    count and k below i; the sum over i of binomial(i - 1, k) is binomial(count, k + 1), which leaves one sum
    over j = k + 1.
    """
    count = np.minimum(count, MAX_SHARING)
    share = 1 - (1 - opacity) ** (1 / count)
    total, term = np.zeros_like(share), np.ones_like(share)
    for j in range(1, int(count.max(initial=1)) + 1):
        term = term * share * np.maximum(count - j + 1, 0) / j  # binomial(count, j) share^j
        total += (-1) ** (j - 1) * term / np.sqrt(j)
    return share, opacity / total


def add_noise(model: Model, rule: MCMC, position_rate: float, rng: Generator, unit: float = 1.0):
    """Moves the Gaussians by noise: Sigma n sigmoid(100 (0.005 - opacity)) noise position_rate, with n normal
    in three dimensions. unit: Camera.unit, in which Sigma counts.

    Sigma = R diag(s^2) R^T, and R^T n has the distribution of n. So n is drawn in the axes of the Gaussian,
    and turned once.
    """
    gate = sigmoid(STEEPNESS * (1 - sigmoid(model.opacity_logits, np) - GATE), np)
    size = gate * model.dtype.type(rule.noise * position_rate / unit**2)
    # max(axis=1) takes ten times as long
    largest = np.maximum(np.maximum(*model.log_scales.T[:2]), model.log_scales[:, 2])
    rows = np.flatnonzero(size * np.exp(largest) > NEGLIGIBLE)
    squares = np.exp(2 * model.log_scales.take(rows, axis=0))
    noise = rng.standard_normal((len(rows), 3), np.float32) * squares * size[rows, None]
    model.means[rows] = model.means.take(rows, axis=0) + rotated(model.quats.take(rows, axis=0), noise)


def penalties(rule: MCMC, unit: float = 1.0) -> tuple[MeanOpacity, MeanScale]:
    """The terms of the loss in every step. unit: Camera.unit, in which scales count."""
    return MeanOpacity(rule.opacity_weight), MeanScale(rule.scale_weight / unit)


def _opacities(model: Model) -> np.ndarray:
    """(N,) float64."""
    return sigmoid(model.opacity_logits.astype(np.float64), np)
