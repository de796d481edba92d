"""The first removal and the first cut (docs/methods.md, "What all methods share")."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ..files.registry import invisible
from ..finetune import scores
from ..finetune.plan import Plan
from ..finetune.viewed_scene import ViewedScene
from ..scene.camera import Camera
from ..scene.gaussians import Scene


def first_cut(
    scene: Scene, views: Sequence[Camera], plan: Plan, target: int, among: np.ndarray | None = None
) -> np.ndarray:
    """The Gaussians that stay, (N,) bool. among (N,) bool: of these alone; None: of all.

    First removal: Gaussians with an opacity below 1/255; no picture changes. First cut: those whose alpha T
    is below plan.min_contribution in every pixel of every view, but never below `target` Gaussians.
    """
    keep = ~invisible(scene) if among is None else among & ~invisible(scene)
    if plan.min_contribution:
        _, peaks, _ = scores.contribution(ViewedScene.of(scene, views, plan.background))
        keep &= (peaks >= plan.min_contribution) | scores.top(np.where(keep, peaks, -1), target)
    return keep
