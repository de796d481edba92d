"""How close methods come to a target: the Gaussians that masks alone would leave against a share, or what is
lost against an allowed loss.

    .venv/bin/python benchmarks/targets.py --data DIR --scene TRAINED.ply [--methods svr,maskgs] [--shares
    0.5,0.25] [--json]
    .venv/bin/python benchmarks/targets.py --data DIR --scene TRAINED.ply --methods removal,svr --drops
    0.2,0.5,1 [--recovery N]                           # or --flips 0.01,0.02, or --lpips 0.01,0.03

Further options (--images DIR, --schedule 0.3) are passed to `svrgs prune`.

`make demo` makes a dataset and a trained scene: build/demo/scene and build/demo/trained.ply. It prints one
row, of JSON or of a table, per method and share or loss. The error of a share is relative, that of a loss
in its unit. The final ranking, which meets a share exactly, is not part of the figure.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from pathlib import Path

from cost import svrgs

ROOT = Path(__file__).resolve().parent.parent
LOSSES = {"drops": "--max-drop", "flips": "--max-flip", "lpips": "--max-lpips"}  # option: that of svrgs
COLUMNS = ("method", "asked", "target", "reached", "error", "strength", "psnr before", "psnr", "count")


def row(options: argparse.Namespace, method: str, flag: str, asked: float, folder: Path) -> dict:
    """The figures of one run. flag: --target or one of LOSSES; asked: its value. It ends the program if the
    run fails."""
    words = ["prune", options.scene, "--data", options.data, "--method", method, flag, asked, "--quiet"]
    words += ["--iterations", options.iterations, "--recovery", options.recovery]
    result = svrgs(*words, "--out", folder / f"{method}.ply", *options.further)
    figures = {name: result[name] for name in ("strength", "psnr", "count")}
    if flag in LOSSES.values():
        figures |= {"target": asked, "reached": result["drop"], "error": result["drop"] - asked}
    elif result["reached"] is None:
        sys.exit(f"{method} learns no masks, so there is nothing to compare")
    else:
        figures |= {
            "target": result["target"],
            "reached": result["reached"],
            "error": result["reached"] / result["target"] - 1,
        }
    return {"method": method, "asked": f"{flag} {asked}", **figures, "psnr before": result["before"]["psnr"]}


def as_text(value) -> str:
    return f"{value:.4g}" if isinstance(value, float) else str(value)


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True)
    parser.add_argument("--scene", type=Path, required=True)
    parser.add_argument("--methods", default="svr,maskgs", type=lambda text: text.split(","))
    numbers = lambda text: [float(part) for part in text.split(",")]
    parser.add_argument("--shares", default="0.5,0.25", type=numbers)
    for name, flag in LOSSES.items():
        parser.add_argument(f"--{name}", type=numbers, help=f"values of {flag}, instead of shares")
    parser.add_argument("--iterations", type=int, default=3_000)
    parser.add_argument("--recovery", type=int, help="recovery steps (default: 0, with --drops 5000)")
    parser.add_argument("--json", action="store_true")
    options, options.further = parser.parse_known_args()
    losses = [(flag, getattr(options, name)) for name, flag in LOSSES.items() if getattr(options, name)]
    flag, values = losses[0] if losses else ("--target", options.shares)
    if options.recovery is None:
        options.recovery = 5_000 if losses else 0
    if not options.json:
        print("| " + " | ".join(COLUMNS) + " |\n|" + "---|" * len(COLUMNS))
    with tempfile.TemporaryDirectory() as folder:
        for method in options.methods:
            for asked in values:
                found = row(options, method, flag, asked, Path(folder))
                print(
                    json.dumps(found)
                    if options.json
                    else "| " + " | ".join(as_text(found[name]) for name in COLUMNS) + " |",
                    flush=True,
                )


if __name__ == "__main__":
    main()
