"""Compact3DGS's mask alone (arXiv 2311.13681 section 3.1): a deterministic gate on opacity and scale, and lambda mean sigmoid(m).

The gate is g = 1[sigmoid(m) > 0.01] in value and sigmoid(m) in gradient. It multiplies the opacity o and the scales s, so

    dL/dg = (dL/do) o + sum_k (dL/ds_k) s_k = dL/dM + sum_k dL/dlog_scale_k       where g = 1

(alpha is proportional to o, so the first term is the rasterizer's dL/dM), and dL/dg = 0 where g = 0: a closed Gaussian is not drawn
and learns no more from the image.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from ..model import MASK, Model
from ..penalties import MeanExistence, sigmoid
from ..scores import top
from ..settings import Phase, Rates
from .base import Keep, RunView
from .masked import Masked

THRESHOLD = np.log(0.01 / 0.99)  # of the logit: sigmoid(m) > 0.01
MASK_RATE = 0.01
NEARNESS = 0.2  # in logits: gates so near the threshold count in part


@dataclass
class Compact3DGS(Masked):
    """Nothing is sampled: events and the end remove the Gaussians with a closed gate."""

    lambda_m: float = 5e-4
    mask_init: float = 1.0

    def terms(self, run: RunView, phase: Phase, number: int) -> dict:
        logits = run.model.values[MASK]
        open_, p = logits > THRESHOLD, sigmoid(logits, np)
        rates = phase.rates.at(number, run.extent)
        rates[MASK] *= MASK_RATE / Rates().mask
        slope = (p * (1 - p) * open_).astype(logits.dtype)
        return {"masks": open_.astype(np.uint8), "slope": slope, "gates": True, "penalty": MeanExistence(run.settings.lambda_m * run.strength), "rates": rates}

    def survivors(self, run: RunView) -> Keep:
        keep = self.current_mask(run.model)
        return keep | top(run.model.values[MASK], run.target) if run.target else keep

    def current_mask(self, model: Model) -> Keep:
        return model.values[MASK] > THRESHOLD

    def expected_count(self, model: Model) -> float:
        """Open gates; gates near the threshold count in part, so that the controller sees them come."""
        return float(sigmoid((model.values[MASK] - THRESHOLD) / NEARNESS, np).sum(dtype=np.float64))


METHODS = (Compact3DGS("compact3dgs", "Compact3DGS: a learned gate on opacity and scale, without its hash grid and quantisation", 11),)
