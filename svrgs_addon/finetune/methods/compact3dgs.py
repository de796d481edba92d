"""The mask of Compact3DGS (arXiv 2311.13681 section 3.1): a deterministic gate on opacity and scale, and the
term lambda_m mean sigmoid(m).

The value of the gate is g = 1[sigmoid(m) > 0.01], its gradient that of sigmoid(m). It multiplies the opacity
o and the scales s:

    dL/dg = (dL/do) o + sum_k (dL/ds_k) s_k = dL/dM + sum_k dL/dlog_scale_k       if g = 1

The first term is the dL/dM of the rasterizer, because alpha is proportional to o. If g = 0, dL/dg = 0: the
Gaussian is not drawn and gets no gradient from the image any more.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model import MASK, Model
from ..penalties import MeanExistence, sigmoid
from ..run_view import Keep, RunView
from ..scores import top
from ..settings import Phase, Rates
from .masked import Masked

THRESHOLD = np.log(0.01 / 0.99)  # logit above which a gate is open: sigmoid(m) > 0.01
MASK_RATE = 0.01  # learning rate of m
NEARNESS = 0.2  # width, in logits, of the sigmoid that counts gates near the threshold in part


@dataclass
class Compact3DGS(Masked):
    """Nothing is sampled. Events and the end of the phase remove Gaussians with a closed gate."""

    lambda_m: float = 5e-4
    mask_init: float = 1.0

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        logits = run.model.values[MASK]
        open_, p = logits > THRESHOLD, sigmoid(logits, np)
        rates = phase.rates.at(number, run.extent)
        rates[MASK] *= MASK_RATE / Rates().mask
        slope = (p * (1 - p) * open_).astype(logits.dtype)
        return {
            "masks": open_.astype(np.uint8),
            "slope": slope,
            "gates": True,
            "penalties": (MeanExistence(run.plan.lambda_m * run.strength),),
            "rates": rates,
        }

    def survivors(self, run: RunView) -> Keep:
        keep = self.current_mask(run.model)
        return keep | top(run.model.values[MASK], run.target) if run.target else keep

    def current_mask(self, model: Model) -> Keep:
        return model.values[MASK] > THRESHOLD

    def expected_count(self, logits: np.ndarray) -> float:
        """The number of open gates, those near the threshold in part: the controller can then react."""
        return float(sigmoid((logits - THRESHOLD) / NEARNESS, np).sum(dtype=np.float64))


METHODS = (
    Compact3DGS(
        "compact3dgs",
        "learns a gate on opacity and scale and removes the Gaussians whose gate closes",
        11,
        "Compact3DGS",
        source="Compact3DGS, arXiv 2311.13681",
    ),
)
