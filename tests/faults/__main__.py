"""python -m tests.faults [--kills 200] [--seed 0] [TARGET ...]: kills a run, a job by blocks, and every
writer, that often; says what survived."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from faults import WRITERS, Survived, done, kill_blocks, kill_run, kill_writer

JOBS = {"run": kill_run, "blocks": kill_blocks}


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults")
    parser.add_argument(
        "targets", nargs="*", metavar="TARGET", help=f"{', '.join((*JOBS, *WRITERS))} (default: all)"
    )
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    for target in options.targets or (*JOBS, *WRITERS):
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            survived = (
                _job(target, Path(folder), options)
                if target in JOBS
                else kill_writer(target, Path(folder), options.kills, options.seed)
            )
        more = (
            f"{survived.resumed} starts from a checkpoint, {survived.finished} runs to the end"
            if target in JOBS
            else f"{survived.finished} times the new file"
        )
        print(
            f"{target}: {survived.kills} kills survived; {more}; {time.monotonic() - started:.0f} s",
            flush=True,
        )
    return 0


def _job(name: str, folder: Path, options: argparse.Namespace) -> Survived:
    import tiny_dataset

    done(lambda: tiny_dataset.write_tiny(folder / "tiny"))  # in a child: it draws
    (folder / "out").mkdir()
    return JOBS[name](
        folder / "tiny" / "scene.ply", folder / "tiny", folder / "out", options.kills, options.seed
    )


if __name__ == "__main__":
    sys.exit(main())
