"""How long large files take to convert, and how much memory: copies of a splat side by side, no two Gaussians
alike.

python benchmarks/large_files.py SPLAT [--count 1000000] [--to .compressed.ply .spz .sog lod-meta.json]

Written: seconds of `svrgs convert` from a PLY, reading included, and its largest anonymous memory (what is
not a file's). Read: seconds from the file to arrays in memory, in a process that has read a file before.
Medians of REPEATS. The copies are N(0, 0.01) apart in SH, so no palette holds them.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from statistics import median

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cost import SVRGS, cost_of
from svrgs_addon.files.memory_mapped import mapped_scene
from svrgs_addon.files.registry import load_parts, load_scene, size_on_disk, write_scene
from svrgs_addon.scene.gaussians import Scene

REPEATS, LARGE = 5, 5_000_000  # of LARGE Gaussians on, once
APART, ROW, NOISE = 10.0, 20, 0.01  # between copies; copies in a row; standard deviation of the noise in SH
HEAD = "| file | MB | write, s | memory, MB | read, s |\n|---|---:|---:|---:|---:|"


def copies(scene: Scene, count: int) -> Iterator[Scene]:
    """Copies of the scene in a grid, `count` Gaussians together."""
    chance = np.random.default_rng(0)
    for number, start in enumerate(range(0, count, scene.count)):
        part = scene.select(np.arange(min(scene.count, count - start)))
        place = np.array([APART * (number % ROW), 0, APART * (number // ROW)], np.float32)
        yield replace(
            part,
            means=part.means + place,
            sh=part.sh + NOISE * chance.standard_normal(part.sh.shape, np.float32),
            attributes={},
            property_order=(),
        )


def seconds_to_read(path: Path, large: bool) -> float:
    started = time.perf_counter()
    if large:
        for _ in load_parts(path):
            pass
    else:
        load_scene(path)
    return time.perf_counter() - started


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("splat", type=Path)
    parser.add_argument("--count", type=int, default=1_000_000)
    parser.add_argument("--to", nargs="+", default=[".compressed.ply", ".spz", ".sog"])
    words = parser.parse_args()
    large = words.count >= LARGE
    with tempfile.TemporaryDirectory() as folder:
        source = Path(folder) / "scene.ply"
        with mapped_scene(copies(load_scene(words.splat), words.count), source) as scene:
            degree = scene.sh_degree
            write_scene(source, scene)
        print(
            f"{words.count:,} Gaussians, SH degree {degree}, a PLY of {source.stat().st_size / 1e6:,.0f}"
            f" MB\n\n{HEAD}",
            flush=True,
        )
        for suffix in words.to:
            out = Path(folder) / (f"out{suffix}" if suffix.startswith(".") else f"out/{suffix}")
            repeats = 1 if large else REPEATS
            runs = []
            for _ in range(repeats):
                out.unlink(missing_ok=True)
                runs.append(cost_of(*SVRGS, "convert", source, out))
            reading = median([seconds_to_read(out, large) for _ in range(repeats + 1)][1:])
            seconds, memory = median(run[0] for run in runs), max(run[1] for run in runs)
            print(
                f"| {suffix} | {size_on_disk(out) / 1e6:,.1f} | {seconds:.2f} | {memory / 1e6:,.0f} |"
                f" {reading:.2f} |",
                flush=True,
            )
    return 0


if __name__ == "__main__":
    sys.exit(main())
