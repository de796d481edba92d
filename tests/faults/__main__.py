"""python -m tests.faults [--kills 200] [--seed 0] [TARGET ...]: kills a run, and every writer, that often; says what survived."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from faults import WRITERS, done, kill_run, kill_writer


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults")
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"run, {', '.join(WRITERS)} (default: all)")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for target in options.targets or ("run", *WRITERS):
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            survived = _run(Path(folder), options) if target == "run" else kill_writer(target, Path(folder), options.kills, options.seed)
        more = (
            f"{survived.resumed} starts from a checkpoint, {survived.finished} runs to the end"
            if target == "run"
            else f"{survived.finished} times the new file"
        )
        print(f"{target}: {survived.kills} kills survived; {more}; {time.monotonic() - started:.0f} s", flush=True)
    return 0


def _run(folder: Path, options: argparse.Namespace):
    import tiny_dataset
    from svrgs_addon.photographs.dataset import load_dataset

    done(lambda: tiny_dataset.write_tiny(folder / "tiny"))  # in a child: it draws
    (folder / "out").mkdir()
    return kill_run(folder / "tiny" / "scene.ply", load_dataset(folder / "tiny"), folder / "out", options.kills, seed=options.seed)


if __name__ == "__main__":
    sys.exit(main())
