"""Quick pruning in memory and by blocks, side by side: on views that neither has seen.

python benchmarks/quick_by_blocks.py SPLAT... [--target 0.25] [--max-drop DB]

Prints a row for each splat: Gaussians, seconds, and the mean PSNR in dB against the original on views that
svrgs rig places with three other seeds.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Sequence
from pathlib import Path
from statistics import fmean

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import by_blocks, plans
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene, run
from svrgs_addon.render.metrics import psnr
from svrgs_addon.render.metrics.evaluate import render_options, rounded_to_8_bits
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.rig import place_rig

SEEDS, SIDES = (5, 6, 7), (512, 1024)  # of the views; pixels


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("splats", type=Path, nargs="+", metavar="SPLAT")
    words.add_argument("--target", type=float, default=0.25)
    words.add_argument("--max-drop", type=float, default=0.0, metavar="DB", help="instead of --target")
    given = words.parse_args()
    goal = {"max_drop": given.max_drop} if given.max_drop else {"target": given.target}
    print(
        "| scene | way | Gaussians | s |",
        *(f"dB, {side}×{side} |" for side in SIDES),
        "\n|---|---|---:|---:|" + "---:|" * len(SIDES),
    )
    for splat in given.splats:
        scene = load_scene(splat)
        rigs = [place_rig(scene, seed=seed).held_out for seed in SEEDS]
        with tempfile.TemporaryDirectory() as folder:
            options = PruneOptions(scene=splat, out=Path(folder) / "out.ply", quick=True, quiet=True, **goal)
            for way, job in {
                "in memory": prune_scene,
                "by blocks": lambda o: run(by_blocks.recipe_of(o, plans.context_of(o), "asked for")),
            }.items():
                result = job(options)
                small = load_scene(options.out)
                values = [fmean(likeness(scene, small, rig, side) for rig in rigs) for side in SIDES]
                print(
                    f"| {splat.stem} | {way} | {result['count']:,} | {result['seconds']:.0f} |",
                    *(f"{value:.2f} |" for value in values),
                    flush=True,
                )


def likeness(scene: Scene, small: Scene, views: Sequence[Camera], side: int) -> float:
    """Mean PSNR in dB of the pictures of `small`, side x side pixels."""
    rasterizer, settings = Rasterizer(), render_options(scene)
    picture = lambda one, view: rounded_to_8_bits(
        rasterizer.forward(one, view.resized(side, side), settings)["rgb"]
    )
    return fmean(psnr(picture(small, view), picture(scene, view)) for view in views)


if __name__ == "__main__":
    main()
