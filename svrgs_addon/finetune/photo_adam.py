"""Adam for values that each photograph has of its own: its exposure, its pose."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

BETAS, EPS = (0.9, 0.999), 1e-8


@dataclass
class PhotoAdam:
    """The state of V photographs: m and v (V, ...), steps (V,)."""

    m: np.ndarray
    v: np.ndarray
    steps: np.ndarray

    def change(self, number: int, grad: np.ndarray, rate: float) -> np.ndarray:
        """What a step adds to one photograph's values, shaped as grad, its gradient; 0 if not finite."""
        if not np.isfinite(grad).all():
            return np.zeros_like(grad)
        self.steps[number] += 1
        t, (first, second) = int(self.steps[number]), BETAS
        self.m[number] = first * self.m[number] + (1 - first) * grad
        self.v[number] = second * self.v[number] + (1 - second) * grad**2
        root = np.sqrt(self.v[number] / (1 - second**t)) + EPS
        return -rate * self.m[number] / (1 - first**t) / root


def rate_at(first: float, last: float, iteration: int, total: int) -> float:
    """The learning rate of iteration 0, 1, ... of `total`, log-linear from the first to the last."""
    return float(first * (last / first) ** (iteration / max(1, total)))
