"""python -m tests.faults [--kills 200] [--disk N] [--memory] [--seed 0] [TARGET ...]: kills a job of every
recipe, and every writer, that often; or fills the disk at the writes of a job; or leaves it little memory.
It says what survived."""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from pathlib import Path

from faults import WRITERS, kill_writer
from faults.jobs import BY_C, JOBS, fill_the_disk, job_named, kill, limit_the_memory


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.faults")
    names = ", ".join((*JOBS, *WRITERS))
    parser.add_argument("targets", nargs="*", metavar="TARGET", help=f"{names} (default: all)")
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--disk", type=int, metavar="N", help="a full disk at N writes of a job; 0: at each")
    parser.add_argument("--memory", action="store_true")
    parser.add_argument("--seed", type=int, default=0)
    options = parser.parse_args()
    jobs_alone = options.memory or options.disk is not None
    for target in options.targets or (JOBS if jobs_alone else (*JOBS, *WRITERS)):
        started = time.monotonic()
        with tempfile.TemporaryDirectory() as folder:
            text = _survived(target, Path(folder), options)
        print(f"{target}: {text}; {time.monotonic() - started:.0f} s", flush=True)
    return 0


def _survived(target: str, folder: Path, options: argparse.Namespace) -> str:
    if target in WRITERS:
        survived = kill_writer(target, folder, options.kills, options.seed)
        return f"{survived.kills} kills survived; {survived.finished} times the new file"
    job = job_named(target, folder)
    if options.disk is not None:
        return f"a full disk at {fill_the_disk(job, options.disk)} writes survived"
    if options.memory:
        said = limit_the_memory(job)
        refused, ended = sum(map(bool, said)), said.count(BY_C)
        return f"{len(said)} limits of memory survived; {refused} too low, of which {ended} {BY_C}"
    survived = kill(job, options.kills, options.seed)
    return (
        f"{survived.kills} kills survived; {survived.resumed} starts from a checkpoint, {survived.finished}"
        " runs to the end"
    )


if __name__ == "__main__":
    sys.exit(main())
