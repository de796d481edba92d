"""How good and how quick pruning without photographs is: measures against the original on unseen views, by
share of the Gaussians.

python benchmarks/no_photographs.py ORIGINAL.ply [OTHER.ply ...] [--shares 0.5,0.25] [--ways quick,tuned]
[--out TABLE.md]

OTHER: reductions of the original by other programs, measured on the same views. Each row of the table: PSNR
in dB, SSIM and FLIP as means of 50 views from above, at 1.55 half diagonals from the middle, none of which a
job has used; seconds and peak anonymous memory of the whole command. With
--cameras, the views are those of a cameras.json or transforms.json instead. With --data, the figures are
those of the test photographs of a dataset, and LPIPS (make lpips) instead of FLIP. The way "decimate" needs
splat-transform (npm install -g @playcanvas/splat-transform).
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cost import SVRGS, cost_of
from judges import Judge, against_photographs, against_scene
from other_writers import splat_transform
from svrgs_addon.files.registry import load_scene
from svrgs_addon.prune.options import DatasetOptions
from svrgs_addon.prune.plans import dataset_of
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.camera_files import load_cameras

SHARES = (0.5, 0.25, 0.125, 0.062)
SECONDS = 90  # of the fine-tuned way
CUT = ("--recovery", 0)
WAYS = {  # name: (what the table calls it, options of svrgs prune)
    "opacity": ("opacity", ("--method", "opacity", *CUT)),
    "contribution": ("sum of alpha T", ("--method", "contribution", *CUT)),
    "once": ("removal error, once", ()),
    "looks": ("removal error, 8 looks", ("--method", "gaussianpop", *CUT)),
    "merge": ("removals and merges, no steps", ("--method", "merge", *CUT)),
    "quick": ("quick", ("--quick",)),
    "decimate": ("splat-transform --decimate", ()),
    "tuned": (f"fine-tuned, --time {SECONDS}", ("--method", "merge", "--time", SECONDS)),
}


def pruned(way: str, path: Path, share: float, folder: Path) -> tuple[Scene, float, float]:
    """The scene after one way of pruning, with seconds and bytes of the command."""
    out = folder / "small.ply"
    if way == "once":
        rig, error = folder / "rig.json", ("--lowest-removal-error", 1 - share, "--invert")
        placed = cost_of(*SVRGS, "rig", path, "--out", rig)
        seconds, memory = cost_of(*SVRGS, "select", path, "--cameras", rig, *error, "--out", out)
        return load_scene(out), placed[0] + seconds, max(placed[1], memory)
    if way == "decimate":
        words = ("--overwrite", "--quiet", "--gpu", "cpu", path, "--decimate", f"{share:%}", out)
        seconds, memory = cost_of(splat_transform(), *words)
    else:
        quiet = () if way == "quick" else ("--quiet",)
        seconds, memory = cost_of(
            *SVRGS, "prune", path, *WAYS[way][1], "--target", share, "--out", out, *quiet
        )
    return load_scene(out), seconds, memory


def rows(path: Path, judge: Judge, words: argparse.Namespace) -> list[str]:
    lines = []
    with tempfile.TemporaryDirectory() as folder:
        for way in words.ways:
            for share in words.shares:
                small, seconds, memory = pruned(way, path, share, Path(folder))
                cost = f"{seconds:.1f} | {memory / 1e9:.2f}"
                lines.append(line(f"{WAYS[way][0]}, {share:.1%}", small, judge, cost))
    return lines + [line(other.name, load_scene(other), judge, " | ") for other in words.others]


def line(name: str, small: Scene, judge: Judge, cost: str) -> str:
    """A row of the table, also printed at once."""
    found = judge(small)
    text = f"| {name} | {small.count:,} | {found[0]:.2f} | {found[1]:.4f} | {found[2]:.4f} | {cost} |"
    print(text, flush=True)
    return text


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("original", type=Path)
    parser.add_argument("others", type=Path, nargs="*")
    parser.add_argument(
        "--shares", type=lambda text: [float(part) for part in text.split(",")], default=SHARES
    )
    ways = [way for way in WAYS if way != "decimate"]
    parser.add_argument("--ways", type=lambda text: text.split(","), default=ways)
    parser.add_argument("--cameras", type=Path, help="views to measure on")
    parser.add_argument("--data", type=Path, help="dataset whose test photographs judge")
    parser.add_argument("--out", type=Path, help="file to append the table to")
    words = parser.parse_args()
    if words.data:
        judge = against_photographs(dataset_of(DatasetOptions(data=words.data)))
    else:
        judge = against_scene(
            load_scene(words.original), load_cameras(words.cameras) if words.cameras else None
        )
    found = "\n".join(rows(words.original, judge, words))
    third = "LPIPS" if words.data else "FLIP"
    table = (
        f"## {words.original.stem}\n\n| what | Gaussians | PSNR, dB | SSIM | {third} | seconds | GB"
        f" |\n|---|---:|---:|---:|---:|---:|---:|\n{found}\n"
    )
    if words.out:
        with open(words.out, "a", encoding="utf-8") as file:
            file.write("\n" + table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
