"""Pruning on photographs in memory and by blocks, side by side, on the photographs that are held out.

python benchmarks/learned_by_blocks.py SPLAT:DATASET... [--method removal svr] [--target 0.4 | --lambda-f 1e-3
| --max-drop 0.5]
    [--iterations 300] [--recovery 500] [--blocks 1 4] [--seeds 0 1 2]

Prints a row for each splat, method and seed: mean PSNR in dB of the splat; and of pruning in memory, and with
each number of blocks: Gaussians that are left, mean PSNR in dB, and seconds. With --lambda-f or --max-drop,
the method decides how many are left.
"""

from __future__ import annotations

import argparse
import math
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cost import SVRGS, cost_of
from svrgs_addon.files.registry import describe, load_scene
from svrgs_addon.finetune.quality import hold_apart
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import evaluate
from svrgs_addon.views.dataset import Dataset, load_dataset

ROOT = Path(__file__).resolve().parents[1]


def main():
    words = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    words.add_argument("scenes", nargs="+", metavar="SPLAT:DATASET")
    words.add_argument("--method", nargs="+", default=["removal", "svr"])
    size = words.add_mutually_exclusive_group()
    size.add_argument("--target", default="0.4")
    size.add_argument("--lambda-f")
    size.add_argument("--max-drop")
    words.add_argument("--iterations", default="300")
    words.add_argument("--recovery", default="500")
    words.add_argument("--blocks", type=int, nargs="+", default=[1, 4])
    words.add_argument("--seeds", nargs="+", default=["0", "1", "2"])
    given = words.parse_args()
    print(
        "| scene | method | seed | before, dB | in memory: Gaussians, dB (s) |",
        *(f"{n} blocks |" for n in given.blocks),
        flush=True,
    )
    print("|---|---|---:|---:|---:|" + "---:|" * len(given.blocks), flush=True)
    others = {"--lambda-f": given.lambda_f, "--max-drop": given.max_drop}
    goal = next(([name, value] for name, value in others.items() if value), ["--target", given.target])
    for scene in given.scenes:
        splat, folder = map(Path, scene.split(":"))
        dataset, whole = load_dataset(folder), describe(splat)["count"]
        if given.max_drop:
            dataset = hold_apart(dataset)  # as each way does
        _, before = quality(splat, dataset)
        for method in given.method:
            for seed in given.seeds:
                same = ["--data", folder, "--method", method, *goal, "--seed", seed]
                same += ["--iterations", given.iterations, "--recovery", given.recovery]
                ways = [["prune", splat, *same, "--visible-mask", "--quiet"]]
                ways += [
                    ["large", "prune", splat, *same, "--block", math.ceil(whole / n)] for n in given.blocks
                ]
                results = [run(way, dataset) for way in ways]
                cells = [f"{count:,}, {psnr:.2f} ({seconds:.0f}) |" for count, psnr, seconds in results]
                print(f"| {splat.stem} | {method} | {seed} | {before:.2f} |", *cells, flush=True)


def run(words: list, dataset: Dataset) -> tuple[int, float, float]:
    """Gaussians, PSNR in dB and seconds of a command."""
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "out.ply"
        seconds, _ = cost_of(*SVRGS, *words, "--out", out)
        return *quality(out, dataset), seconds


def quality(splat: Path, dataset: Dataset) -> tuple[int, float]:
    """Gaussians, and PSNR in dB on the test views."""
    scene = load_scene(splat)
    return scene.count, evaluate(scene, dataset, dataset.test_indices, Rasterizer())["psnr"]


if __name__ == "__main__":
    main()
