"""A few steps of fine-tuning after removals and merges, on the original's own pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from ..camera import Camera
from ..errors import Cancelled
from ..finetune.engine import NativeEngine, Step
from ..finetune.model import Model
from ..finetune.settings import Rates
from ..geometry.morton_order import morton_order
from ..native import RenderOptions
from ..scene import Scene

FASTER = 3.0  # times the rates of 3DGS; all fall to LAST of their first value
LAST = 0.1
POSITION = 0.025  # rate of position, in median middle scales: Gaussians move by fractions of their size


def refit(
    scene: Scene, cameras: Sequence[Camera], pictures: Sequence[np.ndarray], steps: int, options: RenderOptions, seed: int, stop: Callable[[], bool]
) -> Scene:
    """The scene after so many Adam steps on the loss of 3DGS, on one picture each. pictures: (H, W, 3) float32 of each camera. Raises Cancelled
    if stop() says so."""
    model, engine, rng = Model.of(scene), NativeEngine(), np.random.default_rng([seed, 7])
    if scene.count > 1:
        model.reorder(morton_order(model.means))
    middle = float(np.exp(np.median(np.sort(scene.log_scales, axis=1)[:, 1])))
    views: list[int] = []
    for k in range(steps):
        if stop():
            raise Cancelled
        views = views or rng.permutation(len(cameras)).tolist()
        view, share = views.pop(), LAST ** (k / max(1, steps - 1))
        rates = {name: FASTER * share * rate for name, rate in Rates().at(1, 0.0).items()} | {"means": POSITION * middle * share}
        rates["opacity_logits"] /= 2
        engine.step(model, Step(cameras[view], pictures[view], k + 1, rates, options))
    return model.into_scene()
