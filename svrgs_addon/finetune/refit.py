"""A few steps of fine-tuning after removals and merges, on pictures of the original."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np

from ..native.rasterizer import RenderOptions
from ..scene.camera import Camera
from ..scene.gaussians import PARAMETERS, Scene
from ..scene.morton_order import morton_order
from ..system.errors import Cancelled
from .engine import NativeEngine, Step
from .model import Model
from .settings import Rates

# times the rates of 3DGS; they fall to LAST of that
FASTER = {"sh": 3.0, "sh_rest": 24.0, "log_scales": 3.0, "quats": 3.0, "opacity_logits": 1.5}
LAST = 0.1
LARGE_ERROR = 0.02  # of a picture; 34 dB
USUAL = 0.25  # share of the Gaussians down to which the rates are smaller
POSITION = 0.025  # rate of position, in median middle scales: Gaussians move by fractions of their size


@dataclass(frozen=True)
class TrainingView:
    """A view that is trained on, its picture, and the window that counts, if not all of it does."""

    camera: Camera
    picture: np.ndarray  # (H, W, 3) float32, of the window
    window: tuple[slice, slice] | None = None  # rows, columns


def refit(
    scene: Scene,
    views: Sequence[TrainingView | None],
    steps: int,
    pace: float,
    middle: float,
    options: RenderOptions,
    seed: int,
    stop: Callable[[], bool],
) -> Scene:
    """The scene after so many Adam steps on the loss of 3DGS, on one picture each. views: all of them;
    a step on one that is None is left out, the others stay as they are. pace: times all rates. middle:
    middle_scale() of the scene, or of that of which it is a part. Raises Cancelled if stop() says so."""
    model, engine, rng = Model.of(scene), NativeEngine(), np.random.default_rng([seed, 7])
    if scene.count > 1:
        model.reorder(morton_order(model.means))
    left: list[int] = []
    for k in range(steps):
        if stop():
            raise Cancelled
        left = left or rng.permutation(len(views)).tolist()
        if (view := views[left.pop()]) is None:
            continue
        share, usual = pace * LAST ** (k / max(1, steps - 1)), Rates().at(1, 0.0)
        rates = {name: factor * share * usual[name] for name, factor in FASTER.items()}
        rates["means"] = POSITION * middle * share
        engine.step(model, Step(view.camera, view.picture, k + 1, rates, options, window=view.window))
    return model.into_scene()


def interpolated(first: Scene, second: Scene, share: float) -> Scene:
    """(1 - share) of the first scene and `share` of the second, which have the same Gaussians in the same
    order. share: 0 to 1."""
    arrays = {
        name: np.float32(1 - share) * getattr(first, name) + np.float32(share) * getattr(second, name)
        for name in PARAMETERS
    }
    return replace(second, **arrays)


def pace_for(error: float) -> float:
    """Factor on all rates for pictures with this error, the root mean square over values of 0 to 1: where
    little is wrong, large steps do harm."""
    return min(1.0, error / LARGE_ERROR)


def pace_at(share: float) -> float:
    """Factor on all rates with this share of the Gaussians. Where most of them stay, little is to be gained,
    and large steps do harm in other views."""
    return min(1.0, USUAL / share)


def middle_scale(log_scales: np.ndarray) -> float:
    """The median of the middle ones of the three standard deviations of each Gaussian. log_scales: (N, 3)."""
    return float(np.exp(np.median(np.sort(log_scales, axis=1)[:, 1])))
