"""The mean of all values over the last steps of a phase (iterate averaging, Polyak and Juditsky 1992), which
becomes the result.

Each step follows one view, so the values keep moving about the best ones. Their mean lies nearer to these
than the last of them does.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from ..scene.gaussians import PARAMETERS
from .model import Model

ROWS = 8_192  # Gaussians that are worked on at a time, so that they fit into a cache


@dataclass
class Average:
    """The mean of the values, arrays by name as in Model, whose rows must stay the same."""

    values: dict[str, np.ndarray] = field(default_factory=dict)
    samples: int = 0

    def add(self, model: Model):
        """Adds the present values: mean_k = mean_(k-1) + (x_k - mean_(k-1)) / k, by blocks of rows."""
        self.samples += 1
        if not self.values:
            self.values = {name: getattr(model, name).copy() for name in PARAMETERS}
            return
        for name, mean in self.values.items():
            array = getattr(model, name)
            for start in range(0, len(mean), ROWS):
                rows = slice(start, start + ROWS)
                mean[rows] += (array[rows] - mean[rows]) / self.samples

    def put_into(self, model: Model):
        """Gives the model the mean values."""
        for name, mean in self.values.items():
            getattr(model, name)[:] = mean
