"""GaussianPOP (arXiv 2602.06830): ranks by Delta SE, the squared error that the removal of a Gaussian causes
(../saliency.py), in 8 passes.

After each pass the Gaussians of lowest error are removed and the errors of the others are measured again,
without training in between: only one of two Gaussians that can replace each other has a small error once the
other one is gone.
"""

from __future__ import annotations

import numpy as np

from ..saliency import removal_errors
from ..scores import top
from .ranked import Ranked

PASSES = 8  # published as C, the number of times that errors are quantified


class GaussianPOP(Ranked):
    def ranking_passes(self, settings, steps, share):
        # Gaussians that are left out of a rendering take nearly as long
        return [(0.0, 1.0)] * (PASSES - 1) + [(0.0, share)]

    def cut(self, viewed, count):
        """The number of Gaussians falls by the same ratio at each pass."""
        start = viewed.scene.count
        kept = np.ones(start, bool)
        for number in range(1, PASSES + 1):
            errors = removal_errors(viewed, kept)
            left = round(start * (min(count, start) / start) ** (number / PASSES))
            kept = top(np.where(kept, errors, -1.0), left)
        return kept


METHODS = (
    GaussianPOP(
        "gaussianpop",
        "removes, in 8 passes, the Gaussians whose removal changes the photographs least",
        19,
        "GaussianPOP",
        source="GaussianPOP, arXiv 2602.06830",
        ranking=removal_errors,
    ),
)
