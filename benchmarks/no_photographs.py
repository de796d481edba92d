"""How good and how quick `svrgs prune --quick` is: PSNR against the original on unseen views, by share of the Gaussians.

python benchmarks/no_photographs.py ORIGINAL.ply [OTHER.ply ...] [--out TABLE.md]

OTHER: reductions of the original by other programs, measured on the same views. Each row of the table: seconds of the job (reading to writing),
Gaussians, PSNR in dB as the mean of 50 views from above, at 1.55 half diagonals from the middle, none of which the job has used.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from statistics import fmean

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from svrgs_addon.camera import Camera
from svrgs_addon.files.registry import load_scene
from svrgs_addon.jobs.options import PruneOptions
from svrgs_addon.jobs.quick import prune_quick
from svrgs_addon.metrics import psnr
from svrgs_addon.metrics.evaluate import render_options, rounded_to_8_bits
from svrgs_addon.native import Rasterizer
from svrgs_addon.rig.around import cameras_around, middle_and_radius
from svrgs_addon.scene import Scene

SHARES = (0.5, 0.25, 0.125, 0.062)
VIEWS, SIDE = 50, 512


def views_from_above(scene: Scene) -> list[Camera]:
    """VIEWS cameras on the upper half of the sphere, y down, nearer than those of the job and turned against them."""
    middle, _ = middle_and_radius(scene)
    cameras = cameras_around(scene, 2 * VIEWS, SIDE, turn=2.0, nearer=0.97)
    return [camera for camera in cameras if camera.position[1] < middle[1]]


def quality(scene: Scene, original: Scene, cameras: list[Camera]) -> float:
    rasterizer, options = Rasterizer(), render_options(original)
    picture = lambda some, camera: rounded_to_8_bits(rasterizer.forward(some, camera, options)["rgb"])  # noqa: E731
    return fmean(psnr(picture(scene, camera), picture(original, camera)) for camera in cameras)


def rows(path: Path, others: list[Path]) -> list[str]:
    original = load_scene(path).scene
    cameras, lines = views_from_above(original), []
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "small.ply"
        for share in SHARES:
            result = prune_quick(PruneOptions(scene=path, out=out, target=share, quick=True), lambda: False)
            small = load_scene(out).scene
            lines.append(f"| quick, {share:.1%} | {small.count:,} | {quality(small, original, cameras):.2f} | {result['seconds']:.1f} |")
    for other in others:
        small = load_scene(other).scene
        lines.append(f"| {other.name} | {small.count:,} | {quality(small, original, cameras):.2f} | |")
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("original", type=Path)
    parser.add_argument("others", type=Path, nargs="*")
    parser.add_argument("--out", type=Path, help="file to append the table to")
    words = parser.parse_args()
    table = (
        f"## {words.original.stem}\n\n| what | Gaussians | PSNR, dB | seconds |\n|---|---:|---:|---:|\n" + "\n".join(rows(words.original, words.others)) + "\n"
    )
    print(table)
    if words.out:
        with open(words.out, "a", encoding="utf-8") as file:
            file.write("\n" + table)
    return 0


if __name__ == "__main__":
    sys.exit(main())
