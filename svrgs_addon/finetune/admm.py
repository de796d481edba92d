"""ADMM on opacities (GaussianSpa, arXiv 2411.06019): a proxy z that is 0 for the Gaussians that are to go,
and a dual variable u.

The loss gets rho/2 |o - (z - u)|^2. The dual u and the goal z - u are among the model's values, so that rows
move with them and checkpoints hold them. They are not learned.
"""

from __future__ import annotations

import numpy as np

from .model import Model
from .penalties import OpacityGoal, sigmoid

DUAL, GOAL = "admm_dual", "admm_goal"


def begun(model: Model) -> bool:
    """Whether project() was called."""
    return GOAL in model.values


def project(model: Model, stays: np.ndarray):
    """z becomes o + u for Gaussians of `stays` (N,) bool, else 0; then u, at first 0, grows by o - z."""
    o = sigmoid(model.opacity_logits, np)
    u = model.values[DUAL] if begun(model) else np.zeros_like(o)
    z = np.where(stays, o + u, 0).astype(o.dtype)
    u = u + o - z if begun(model) else u
    model.add(DUAL, u)
    model.add(GOAL, z - u)


def pull(model: Model, rho: float) -> OpacityGoal:
    """The term of the loss."""
    return OpacityGoal(rho, model.values[GOAL])
