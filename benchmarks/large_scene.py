"""A generated town through `svrgs large`: seconds of each step, memory, and what the number of blocks
changes.

python benchmarks/large_scene.py [--count 5000000] [--blocks 1 4 16] [--views 72] [--target 0.25] [--to .ply]
[--folder DIR]

The town is a square of nine rooms (bench/scenes.py), SH degree 3. Three quarters of the views are within
rooms, the others look down on them from above their roofs; every eighth is held out and measured. Memory: the
most anonymous memory of a step, without what the system can drop again (files that are mapped). Space in DIR:
about three times the size of the PLY, which has 248 bytes for each Gaussian.
"""

from __future__ import annotations

import argparse
import hashlib
import math
import shutil
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from cost import result_and_cost
from svrgs_addon.files.memory_mapped import mapped_scene
from svrgs_addon.files.registry import write_scene
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_bench.scenes import look_at, orbit_camera, room

ROOMS, SIDE, APART = 9, 3, 9.0  # of the town; rooms in a row, and the distance between them
WIDTH, HEIGHT = 1280, 720
STEPS = ("divide", "score", "reduce", "merge", "cut", "tune", "finish")


def town(count: int) -> Iterator[Scene]:
    """The rooms, one after the other."""
    for number in range(ROOMS):
        one = room(count // ROOMS + (number < count % ROOMS), 3, number)
        yield replace(one, means=one.means + place_of(number))


def place_of(number: int) -> np.ndarray:
    return np.array([APART * (number % SIDE), 0, APART * (number // SIDE)], np.float32)


def views(count: int) -> list[Camera]:
    """Of each room, views within it all around, and every fourth from above its roof."""
    found = []
    for number in range(count):
        place, turn = place_of(number % ROOMS).astype(np.float64), number // ROOMS / math.ceil(count / ROOMS)
        if number // ROOMS % 4 == 3:
            camera = look_at(place + [0, -6, -6], place + [0, 0, 4], WIDTH, HEIGHT)
        else:
            camera = orbit_camera(WIDTH, HEIGHT, turn)
            viewmat = camera.viewmat.copy()
            viewmat[:3, 3] -= viewmat[:3, :3] @ place
            camera = replace(camera, viewmat=viewmat)
        found.append(replace(camera, name=f"{number:04}"))
    return found


def measure(source: Path, folder: Path, block: int, target: float, suffix: str) -> list[str]:
    """A line of the table."""
    work, out = folder / "work", folder / f"out{suffix}"
    words = {
        "divide": ["divide", source, "--cameras", folder / "cameras.json", "--work", work, "--block", block],
        "cut": ["cut", work, "--target", target],
        "finish": ["finish", work, "--out", out],
    }
    cells, most, result = [], 0, {}
    for step in STEPS:
        result, seconds, memory = result_and_cost("large", *words.get(step, [step, work]))
        cells, most = [*cells, f"{seconds:.0f}"], max(most, memory)
        if step == "score":
            (scores,) = work.glob("scores_*.npy")
            with open(scores, "rb") as file:
                digest = hashlib.file_digest(file, "sha256").hexdigest()[:8]
        if step == "reduce":
            for path in work.glob("scores_*.npy"):
                path.unlink()
    line = [
        str(result["blocks"]),
        *cells,
        f"{most / 1e9:.2f}",
        digest,
        f"{result['after']['bytes'] / 1e6:,.1f}",
        f"{result['psnr_merged']:.2f}",
        f"{result['psnr']:.2f}",
        str(result["tuned_share"]),
    ]
    shutil.rmtree(work)
    return line


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5_000_000)
    parser.add_argument("--blocks", type=int, nargs="+", default=[1, 4, 16])
    parser.add_argument("--views", type=int, default=72)
    parser.add_argument("--target", type=float, default=0.25)
    parser.add_argument("--to", default=".ply")
    parser.add_argument("--folder", type=Path)
    words = parser.parse_args()
    with tempfile.TemporaryDirectory(dir=words.folder) as name:
        folder = Path(name)
        source = folder / "town.ply"
        with mapped_scene(town(words.count), source) as scene:
            write_scene(source, scene)
        write_cameras_json(folder / "cameras.json", views(words.views))
        print(
            f"{words.count:,} Gaussians, SH degree 3, a PLY of {source.stat().st_size / 1e6:,.0f} MB,"
            f" {words.views} views of {WIDTH} x {HEIGHT} pixels\n"
        )
        print(
            f"| blocks | {', s | '.join(STEPS)}, s | memory, GB | sums (SHA-256) | MB | merged, dB | tuned,"
            " dB | share of tuned |"
        )
        print(f"|{'---:|' * (len(STEPS) + 7)}", flush=True)
        for blocks in words.blocks:
            row = measure(source, folder, math.ceil(words.count / blocks), words.target, words.to)
            print(f"| {' | '.join(row)} |", flush=True)
    return 0


if __name__ == "__main__":
    sys.exit(main())
