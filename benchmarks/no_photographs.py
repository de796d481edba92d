"""How good and how quick pruning without photographs is: measures against the original on unseen views, by
share of the Gaussians.

python benchmarks/no_photographs.py ORIGINAL.ply [OTHER.ply ...] [--shares 0.5,0.25] [--ways quick,tuned]
[--out TABLE.md]

OTHER: reductions of the original by other programs, measured on the same views. Each row of the table: PSNR
in dB, SSIM and FLIP as means of 50 views from above, at 1.55 half diagonals from the middle, none of which a
job has used; seconds and peak memory of the whole command. With
--cameras, the views are those of a cameras.json or transforms.json instead.
"""

from __future__ import annotations

import argparse
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import fmean

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from svrgs_addon.files.registry import load_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics import flip, psnr, ssim
from svrgs_addon.render.metrics.evaluate import render_options, rounded_to_8_bits
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.camera_files import load_cameras
from svrgs_addon.views.rig.around import cameras_around, middle_and_radius

SHARES = (0.5, 0.25, 0.125, 0.062)
VIEWS, SIDE = 50, 512
SECONDS = 90  # of the fine-tuned way
CUT = ("--recovery", 0)
WAYS = {  # name: (what the table calls it, options of svrgs prune)
    "opacity": ("opacity", ("--method", "opacity", *CUT)),
    "contribution": ("sum of alpha T", ("--method", "contribution", *CUT)),
    "once": ("removal error, once", ()),
    "looks": ("removal error, 8 looks", ("--method", "gaussianpop", *CUT)),
    "merge": ("removals and merges, no steps", ("--method", "merge", *CUT)),
    "quick": ("quick", ("--quick",)),
    "tuned": (f"fine-tuned, --time {SECONDS}", ("--method", "merge", "--time", SECONDS)),
}


def views_from_above(scene: Scene) -> list[Camera]:
    """VIEWS cameras on the upper half of the sphere, y down, nearer than those of the quick way and turned
    against them."""
    middle, _ = middle_and_radius(scene)
    cameras = cameras_around(scene, 2 * VIEWS, SIDE, turn=2.0, nearer=0.97)
    return [camera for camera in cameras if camera.position[1] < middle[1]]


def measures(scene: Scene, original: Scene, cameras: list[Camera]) -> tuple[float, float, float]:
    """PSNR, SSIM and FLIP against the original, means over the views."""
    rasterizer, options, rows = Rasterizer(), render_options(original), []
    for camera in cameras:
        images = [
            rounded_to_8_bits(rasterizer.forward(some, camera, options)["rgb"]) for some in (scene, original)
        ]
        rows.append((psnr(*images), ssim(*images), flip(*images)))
    found = [fmean(column) for column in zip(*rows, strict=True)]
    return found[0], found[1], found[2]


def run(*words: object) -> tuple[float, float]:
    """Runs `svrgs`. Seconds and peak memory in bytes of the command."""
    started = time.perf_counter()
    child = subprocess.Popen(
        [sys.executable, "-m", "svrgs_addon", *map(str, words)],
        stdout=subprocess.DEVNULL,
        cwd=Path(__file__).resolve().parents[1],
    )
    _, status, usage = os.wait4(child.pid, 0)
    child.returncode = os.waitstatus_to_exitcode(status)
    if child.returncode:
        raise SystemExit(f"{' '.join(map(str, words))}: exit status {child.returncode}")
    return time.perf_counter() - started, usage.ru_maxrss * 1024


def pruned(way: str, path: Path, share: float, folder: Path) -> tuple[Scene, float, float]:
    """The scene after one way of pruning, with seconds and bytes of the command."""
    out = folder / "small.ply"
    if way == "once":
        rig = folder / "rig.json"
        placed = run("rig", path, "--out", rig)
        seconds, memory = run(
            "select", path, "--cameras", rig, "--lowest-removal-error", 1 - share, "--invert", "--out", out
        )
        return load_scene(out).scene, placed[0] + seconds, max(placed[1], memory)
    seconds, memory = run(
        "prune",
        path,
        *WAYS[way][1],
        "--target",
        share,
        "--out",
        out,
        *(() if way == "quick" else ("--quiet",)),
    )
    return load_scene(out).scene, seconds, memory


def rows(path: Path, words: argparse.Namespace) -> list[str]:
    original, lines = load_scene(path).scene, []
    cameras = load_cameras(words.cameras) if words.cameras else views_from_above(original)
    with tempfile.TemporaryDirectory() as folder:
        for way in words.ways:
            for share in words.shares:
                small, seconds, memory = pruned(way, path, share, Path(folder))
                lines.append(
                    line(
                        f"{WAYS[way][0]}, {share:.1%}",
                        small,
                        original,
                        cameras,
                        f"{seconds:.1f} | {memory / 1e9:.2f}",
                    )
                )
    return lines + [
        line(other.name, load_scene(other).scene, original, cameras, " | ") for other in words.others
    ]


def line(name: str, small: Scene, original: Scene, cameras: list[Camera], cost: str) -> str:
    """A row of the table, also printed at once."""
    found = measures(small, original, cameras)
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
    parser.add_argument("--ways", type=lambda text: text.split(","), default=list(WAYS))
    parser.add_argument("--cameras", type=Path, help="views to measure on")
    parser.add_argument("--out", type=Path, help="file to append the table to")
    words = parser.parse_args()
    found = "\n".join(rows(words.original, words))
    table = (
        f"## {words.original.stem}\n\n| what | Gaussians | PSNR, dB | SSIM | FLIP | seconds | GB"
        f" |\n|---|---:|---:|---:|---:|---:|---:|\n{found}\n"
    )
    if words.out:
        with open(words.out, "a", encoding="utf-8") as file:
            file.write("\n" + table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
