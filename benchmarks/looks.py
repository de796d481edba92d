"""Run time against error of a decision: how many of the Gaussians that stay differ from those of the exact
look (float64, full size, all views), and how long the look takes.

    .venv/bin/python benchmarks/looks.py SCENE.ply --data DATASET > docs/results/looks.jsonl

What the PSNR is in the end, after a whole run with such looks: benchmarks/methods.py --study looks.
"""

from __future__ import annotations

import argparse
import json
import statistics
import time
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np

from svrgs_addon.files.registry import read_scene
from svrgs_addon.finetune.saliency import removal_errors
from svrgs_addon.finetune.scores import top
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.library import supported_levels
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.views.dataset import load_dataset

# reduction of the pictures per side, every how many views, SIMD level ("": the fastest)
LOOKS: dict[str, tuple[int, int, str]] = {
    "exact": (1, 1, "float64"),
    "float32": (1, 1, ""),
    "AVX2": (1, 1, "avx2"),
    "no SIMD": (1, 1, "scalar"),
    "half the size, the default": (2, 1, ""),
    "a quarter of the size": (4, 1, ""),
    "half of the views": (1, 2, ""),
    "a quarter of the views": (1, 4, ""),
    "half the size, half of the views": (2, 2, ""),
    "half the size, a quarter of the views": (2, 4, ""),
}
SHARES = (0.5, 0.25, 0.1, 0.05)  # of the Gaussians that stay
ROUNDS = 3  # of each look, of which the median counts


def look(name: str) -> Callable[..., np.ndarray]:
    """The ranking of `removal` with a look of LOOKS."""
    reduction, every, level = LOOKS[name]

    def ranking(viewed: ViewedScene) -> np.ndarray:
        rasterizer, scene = Rasterizer(level or None), viewed.scene
        arrays = {key: np.asarray(getattr(scene, key), rasterizer.dtype) for key in PARAMETERS}
        own = SimpleNamespace(**arrays, count=scene.count, antialiased=scene.antialiased)
        return removal_errors(
            ViewedScene(own, viewed.cameras[::every], rasterizer, viewed.options), reduction=reduction
        )

    return ranking


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("scene")
    parser.add_argument("--data", required=True)
    parser.add_argument("--images")
    options = parser.parse_args()
    scene, dataset = read_scene(options.scene), load_dataset(options.data, options.images, cameras_only=True)
    cameras = dataset.training_cameras
    exact: list[np.ndarray] = []
    for name, (_, _, level) in LOOKS.items():
        if level and level not in supported_levels():
            continue
        seconds, errors = [], np.empty(0)
        for _ in range(1 if name == "exact" else ROUNDS):
            started = time.perf_counter()
            errors = look(name)(ViewedScene.of(scene, cameras))
            seconds.append(time.perf_counter() - started)
        kept = [top(errors, round(share * scene.count)) for share in SHARES]
        exact = exact or kept
        differ = [float((right & ~ours).sum() / right.sum()) for ours, right in zip(kept, exact, strict=True)]
        differs = dict(zip(map(str, SHARES), differ, strict=True))
        print(
            json.dumps({"look": name, "seconds": statistics.median(seconds), "differs": differs}), flush=True
        )


if __name__ == "__main__":
    main()
