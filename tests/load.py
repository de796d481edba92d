"""python -m tests.load [--count 5000000]: a large generated scene through the commands; time and peak memory
of each.

Each stage is a process of its own that is refused memory beyond --gigabytes; the files are removed in the
end.
"""

from __future__ import annotations

import argparse
import contextlib
import io
import json
import os
import resource
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from faults import forked
from svrgs_addon.cli.main import main as run_svrgs

VIEWS = 8
SHARE = 0.3  # kept where a score decides


def stages(folder: Path, options: argparse.Namespace) -> dict[str, Callable[[], object]]:
    scene, kept, half = folder / "scene.ply", int(SHARE * options.count), options.steps // 2
    threads, data = ("--threads", options.threads), ("--data", folder)

    def pruned(method: str, *words, **expected):
        words = "--quiet", "--method", method, *words, "--out", folder / f"{method}.ply"
        return command("prune", scene, *data, *threads, *words, **expected)

    few, steps = ("--target-count", kept, "--recovery", 0), ("--iterations", half, "--recovery", half)
    return {
        "generate": lambda: generate(folder, options),
        "info": command("info", scene, *threads, count=options.count),
        "render": command("render", scene, *data, *threads, "--views", 0, "--out", folder / "pictures"),
        "opacity": pruned("opacity", *few, count=kept),
        "max-contribution": pruned("max-contribution", *few, count=kept),
        f"{2 * half} steps": pruned(
            "svr", "--min-contribution", 0, *steps, iterations=2 * half, nonfinite_gradients=0
        ),
    }


def generate(folder: Path, options: argparse.Namespace):
    """The scene, and photographs of it with their COLMAP model."""
    from colmap_model import write_colmap
    from svrgs_addon.files.images import write_image
    from svrgs_addon.files.ply import write_ply
    from svrgs_addon.native import library
    from svrgs_addon.native.rasterizer import Rasterizer
    from svrgs_bench.scenes import orbit_camera, room

    library.set_threads(options.threads)
    scene, rasterizer = room(options.count), Rasterizer()
    write_ply(folder / "scene.ply", scene)
    cameras = [
        replace(orbit_camera(*options.size, turn=360 * i / VIEWS), name=f"{i:02}.png") for i in range(VIEWS)
    ]
    for camera in cameras:
        write_image(folder / "images" / camera.name, rasterizer.forward(scene, camera)["rgb"])
    write_colmap(folder / "sparse" / "0", cameras, scene.means[:100])


def command(*words, **expected) -> Callable[[], object]:
    """`svrgs WORDS --json`; expected: what its result must say."""

    def run():
        with contextlib.redirect_stdout(io.StringIO()) as said:
            status = run_svrgs([*map(str, words), "--json"])
        assert status == 0, f"exit status {status}"
        result = json.loads(said.getvalue())
        found = {name: result[name] for name in expected}
        assert found == expected, f"{found} instead of {expected}"

    return run


def measured(work: Callable[[], object]) -> tuple[int, str]:
    """The work in a process of its own: its exit status, and what it took."""
    started = time.perf_counter()
    _, status, usage = os.wait4(forked(work), 0)
    seconds, busy = time.perf_counter() - started, usage.ru_utime + usage.ru_stime
    return os.waitstatus_to_exitcode(
        status
    ), f"{seconds:8.1f} s, {busy:8.1f} s of processors, {1024 * usage.ru_maxrss / 1e6:6.0f} MB"


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.load")
    parser.add_argument("--count", type=int, default=5_000_000)
    size = {"nargs": 2, "default": (640, 480), "metavar": "PIXELS"}
    parser.add_argument("--size", type=int, **size, help="of a photograph (default: 640 480)")
    parser.add_argument("--steps", type=int, default=50, help="of fine-tuning (default: 50)")
    parser.add_argument("--gigabytes", type=float, default=16, help="of memory for a process (default: 16)")
    parser.add_argument("--threads", type=int, default=0)
    options = parser.parse_args()
    resource.setrlimit(resource.RLIMIT_AS, (int(options.gigabytes * 1e9),) * 2)
    with tempfile.TemporaryDirectory() as folder:
        for name, work in stages(Path(folder), options).items():
            status, taken = measured(work)
            print(f"{name:18}{taken}", flush=True)
            if status:
                print(f"{name} failed", file=sys.stderr)
                return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
