"""The time and the imports of `svrgs info`; the time to write and to read a large PLY file."""

from __future__ import annotations

import statistics
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

ROOT = Path(__file__).resolve().parents[1]
HEAVY = ("torch", "pycolmap", "OpenImageIO", "scipy", "bpy")
INFO = (
    "import sys; from svrgs_addon.cli.main import main; main(sys.argv[1:]); print(*{n.partition('.')[0] for n"
    " in sys.modules}, file=sys.stderr)"
)


def start_up(scene: Path, runs: int = 7) -> dict:
    """Median seconds of `svrgs info SCENE` as a whole process, and of a Python process that does nothing; the
    modules that `info` loads."""
    seconds, bare = [], []
    for _ in range(runs):
        seconds.append(_seconds([sys.executable, "-m", "svrgs_addon", "info", str(scene), "--json"]))
        bare.append(_seconds([sys.executable, "-c", "pass"]))
    done = subprocess.run(
        [sys.executable, "-c", INFO, "info", str(scene)], cwd=ROOT, capture_output=True, text=True, check=True
    )
    loaded = set(done.stderr.split())
    return {
        "info_seconds": statistics.median(seconds),
        "python_seconds": statistics.median(bare),
        "modules": len(loaded),
        "third_party": sorted(loaded & {"numpy", *HEAVY}),
    }


def ply_times(count: int = 1_000_000, runs: int = 3) -> dict:
    """Median seconds to write and to read a PLY file of `count` Gaussians of SH degree 3, and its bytes."""
    from svrgs_addon.files.ply import read_ply, write_ply
    from svrgs_addon.scene.gaussians import Scene

    rng = np.random.default_rng(0)
    shapes = {"means": (3,), "log_scales": (3,), "quats": (4,), "opacity_logits": (), "sh": (16, 3)}
    scene = Scene(
        **{name: rng.standard_normal((count, *shape), np.float32) for name, shape in shapes.items()}
    )
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "scene.ply"
        written = statistics.median(_timed(write_ply, path, scene) for _ in range(runs))
        read = statistics.median(_timed(read_ply, path) for _ in range(runs))
        return {"count": count, "bytes": path.stat().st_size, "write_seconds": written, "read_seconds": read}


def _timed(function, *arguments) -> float:
    started = time.perf_counter()
    function(*arguments)
    return time.perf_counter() - started


def _seconds(command: list[str]) -> float:
    return _timed(lambda: subprocess.run(command, cwd=ROOT, stdout=subprocess.DEVNULL, check=True))
