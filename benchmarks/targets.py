"""How near learned methods come to a target by themselves: Gaussians that masks alone would leave against those asked for.

    .venv/bin/python benchmarks/targets.py --colmap DIR --scene TRAINED.ply [--methods svr-mask,maskgs] [--shares 0.5,0.25] [--iterations N] [--json]

`make demo` leaves such a pair: build/demo/scene and build/demo/trained.ply. The final ranking, which meets the target exactly, is
not part of the figure. A row of JSON or of the table for each method and share.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
COLUMNS = ("method", "share", "target", "reached", "error", "strength", "psnr before", "psnr")


def row(options: argparse.Namespace, method: str, share: float, folder: Path) -> dict:
    words = ["--iterations", options.iterations, "--recovery", options.recovery, "--out", folder / f"{method}.ply", "--quiet", "--json"]
    command = [sys.executable, "-m", "svrgs_addon", "prune", options.scene, "--colmap", options.colmap, "--method", method, "--target", share, *words]
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run([str(word) for word in command], capture_output=True, text=True, env=environment)
    if done.returncode:
        sys.exit(f"{method} at {share}: {done.stderr.strip().splitlines()[-1]}")
    result = json.loads(done.stdout)
    figures = {name: result[name] for name in ("target", "reached", "strength", "psnr")}
    if result["reached"] is None:
        sys.exit(f"{method} learns no masks: there is nothing to compare")
    error = result["reached"] / result["target"] - 1
    return {"method": method, "share": share, **figures, "error": error, "psnr before": result["before"]["psnr"]}


def as_text(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main():
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--colmap", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--methods", default="svr-mask,maskgs", type=lambda text: text.split(","))
    parser.add_argument("--shares", default="0.5,0.25", type=lambda text: [float(part) for part in text.split(",")])
    parser.add_argument("--iterations", type=int, default=3_000)
    parser.add_argument("--recovery", type=int, default=0)
    parser.add_argument("--json", action="store_true")
    options = parser.parse_args()
    if not options.json:
        print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    with tempfile.TemporaryDirectory() as folder:
        for method in options.methods:
            for share in options.shares:
                found = row(options, method, share, Path(folder))
                print(json.dumps(found) if options.json else "| " + " | ".join(as_text(found[name]) for name in COLUMNS) + " |", flush=True)


if __name__ == "__main__":
    main()
