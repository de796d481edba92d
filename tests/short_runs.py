"""What tests of short runs share: disturbed scenes, an engine that changes nothing, ends, bits, and
quality."""

import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from svrgs_addon.finetune import checkpoint
from svrgs_addon.finetune.engine import StepResult
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics import psnr
from svrgs_addon.scene.gaussians import PARAMETERS, Scene
from svrgs_addon.views.dataset import Dataset


def logit(p: float) -> float:
    return math.log(p / (1 - p))


def quality(scene, dataset: Dataset) -> float:
    """Mean PSNR over all views, dB."""
    rasterizer = Rasterizer()
    renders = [rasterizer.forward(scene, camera)["rgb"].clip(0, 1) for camera in dataset.cameras]
    return float(
        np.mean(
            [psnr(render, picture / 255) for render, picture in zip(renders, dataset.pictures, strict=True)]
        )
    )


def to_the_end(run: Run) -> Run:
    while not run.finished:
        run.advance()
    run.close()
    return run


def counts_of(run: Run) -> list[int]:
    """Gaussians after each step."""
    counts = []
    while not run.finished:
        run.advance()
        counts.append(run.model.count)
    run.close()
    return counts


def whole_and_taken_up(make: Callable[[], Run], folder: Path, steps: int = 9) -> tuple[Run, Run]:
    """A run to its end, and one that goes on where another was saved after so many steps."""
    whole, first, second = to_the_end(make()), make(), make()
    for _ in range(steps):
        first.advance()
    checkpoint.save(first, folder, "id")
    assert checkpoint.restore(second, folder, "id")
    return whole, to_the_end(second)


def bits(model: Model) -> dict[str, bytes]:
    parts = {"values": model.values, "moments": model.moments, "": {"origin": model.origin}}
    return {
        f"{part} {name}": array.tobytes() for part, found in parts.items() for name, array in found.items()
    }


def disturbed(scene: Scene, seed: int = 5) -> Scene:
    rng = np.random.default_rng(seed)
    arrays = {
        name: getattr(scene, name) + rng.normal(0, 0.06, getattr(scene, name).shape) for name in PARAMETERS
    }
    return replace(scene, **{name: array.astype(np.float32) for name, array in arrays.items()})


class Puller:
    """An engine that changes nothing and reports a strong pull at the first Gaussian; keeps the steps it was
    given."""

    def __init__(self):
        self.steps = []

    def step(self, model: Model, step) -> StepResult:
        self.steps.append(step)
        seen = np.arange(model.count, dtype=np.uint32)
        means2d = np.zeros((model.count, 2), model.dtype)
        means2d[0] = 1
        return StepResult(0.1, 0.9, 0.0, seen, means2d)
