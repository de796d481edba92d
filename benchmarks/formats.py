"""How large and how exact each format is: bytes, quality against the original, seconds to write and to read.

python benchmarks/formats.py SPLAT... [--against ORIGINAL] [--quantise FACTOR...] [--data DATASET] [--out TABLE.md]

PSNR in dB, SSIM and FLIP are means of the 50 views of no_photographs.py, against the splat itself or, of one
that was pruned, its original. Seconds: medians of REPEATS, of the scene in memory to the file and back. With
--quantise, only formats that take it, newest versions. With --data, figures are those of its test views against
the photographs, LPIPS (make lpips) instead of FLIP; formats that round by where a splat is seen from are
written as `svrgs prune` does, by the training views, and as `svrgs convert` does, without.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from no_photographs import measures, views_from_above
from svrgs_addon.files.registry import FORMATS, load_scene, write_scene
from svrgs_addon.scene.gaussians import Scene

REPEATS = 5
HEAD = (
    "| file | bytes per Gaussian | MB | PSNR, dB | SSIM | {} | write, s | read, s"
    " |\n|---|---:|---:|---:|---:|---:|---:|---:|"
)


def seconds(work: Callable[[], object]) -> float:
    times = []
    for _ in range(REPEATS):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return median(times)


def kinds(factors: list[float]) -> list[tuple[str, int, float]]:
    """(suffix, version, quantise) of all formats that are written; of those that take quantise, if factors
    are given."""
    written = [one for one in FORMATS if one.write and one.suffixes]
    if factors:
        return [(one.suffixes[0], 0, factor) for one in written if one.quantises for factor in factors]
    return [(one.suffixes[0], version, 1.0) for one in written for version in one.versions or (0,)]


def rows(scene: Scene, original: Scene, folder: Path, factors: list[float]) -> list[str]:
    cameras, lines = views_from_above(original), []
    for suffix, version, factor in kinds(factors):
        path = folder / f"scene{suffix}"
        writing = seconds(
            lambda path=path, version=version, factor=factor: write_scene(path, scene, version, factor)
        )
        reading = seconds(lambda path=path: load_scene(path))
        found, size = measures(load_scene(path).scene, original, cameras), path.stat().st_size
        quality = f"{found[0]:.2f} | {found[1]:.4f} | {found[2]:.4f}" if found[0] < 100 else "equal | 1 | 0"
        name = suffix + (f" version {version}" if version else "")
        name += f" --quantise {factor:g}" if factors else ""
        lines.append(
            f"| {name} | {size / scene.count:.1f} | {size / 1e6:.2f} | {quality} | {writing:.2f} |"
            f" {reading:.2f} |"
        )
        print(lines[-1], flush=True)
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("splats", type=Path, nargs="+")
    parser.add_argument("--against", type=Path, help="the original of splats that were pruned")
    parser.add_argument(
        "--quantise", type=float, nargs="+", default=[], help="factors of svrgs convert --quantise"
    )
    parser.add_argument("--out", type=Path, help="file to append the tables to")
    words = parser.parse_args()
    for path in words.splats:
        scene = load_scene(path).scene
        original = load_scene(words.against).scene if words.against else scene
        with tempfile.TemporaryDirectory() as folder:
            table = "\n".join(
                [
                    f"\n### {path.stem}, {scene.count:,} Gaussians, SH degree {scene.sh_degree}\n",
                    HEAD,
                    *rows(scene, original, Path(folder), words.quantise),
                ]
            )
        if words.out:
            with open(words.out, "a", encoding="utf-8") as file:
                file.write(table + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
