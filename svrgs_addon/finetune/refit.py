"""A few steps of fine-tuning after removals and merges, on the original's own pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np

from ..camera import Camera
from ..errors import Cancelled
from ..geometry.morton_order import morton_order
from ..native import RenderOptions
from ..native_library import PARAMETERS
from ..scene import Scene
from .engine import NativeEngine, Step
from .model import Model
from .settings import Rates

FASTER = {"sh": 3.0, "sh_rest": 24.0, "log_scales": 3.0, "quats": 3.0, "opacity_logits": 1.5}  # times the rates of 3DGS; they fall to LAST of that
LAST = 0.1
USUAL = 0.25  # share of the Gaussians down to which the rates are smaller
POSITION = 0.025  # rate of position, in median middle scales: Gaussians move by fractions of their size


def refit(
    scene: Scene, cameras: Sequence[Camera], pictures: Sequence[np.ndarray], steps: int, pace: float, options: RenderOptions, seed: int,
    stop: Callable[[], bool],
) -> Scene:  # fmt: skip
    """The scene after so many Adam steps on the loss of 3DGS, on one picture each. pictures: (H, W, 3) float32 of each camera. pace: times all rates.
    Raises Cancelled if stop() says so."""
    model, engine, rng = Model.of(scene), NativeEngine(), np.random.default_rng([seed, 7])
    if scene.count > 1:
        model.reorder(morton_order(model.means))
    middle = middle_scale(scene)
    views: list[int] = []
    for k in range(steps):
        if stop():
            raise Cancelled
        views = views or rng.permutation(len(cameras)).tolist()
        view, share = views.pop(), pace * LAST ** (k / max(1, steps - 1))
        usual = Rates().at(1, 0.0)
        rates = {name: factor * share * usual[name] for name, factor in FASTER.items()} | {"means": POSITION * middle * share}
        engine.step(model, Step(cameras[view], pictures[view], k + 1, rates, options))
    return model.into_scene()


def interpolated(first: Scene, second: Scene, share: float) -> Scene:
    """(1 - share) of the first scene and `share` of the second, which have the same Gaussians in the same order. share: 0 to 1."""
    arrays = {name: np.float32(1 - share) * getattr(first, name) + np.float32(share) * getattr(second, name) for name in PARAMETERS}
    return replace(second, **arrays)


def pace_at(share: float) -> float:
    """Factor on all rates with this share of the Gaussians. Where most of them stay, little is to be gained, and large steps do harm in other views."""
    return min(1.0, USUAL / share)


def middle_scale(scene: Scene | Model) -> float:
    """The median of the middle ones of the three standard deviations of each Gaussian."""
    return float(np.exp(np.median(np.sort(scene.log_scales, axis=1)[:, 1])))
