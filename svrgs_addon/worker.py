"""One pruning job in a process of its own: a crash or an exhausted memory ends that job, not the batch.

Parent: run_in_child(). Child: `python -m svrgs_addon.worker`, the command's options as one JSON object on stdin, the
result, or {"error": sentence}, as one on stdout; progress and warnings on stderr.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
from pathlib import Path

PATHS = ("scene", "colmap", "out", "report", "lpips_weights")


def run_in_child(options: dict) -> tuple[int, dict]:
    """Runs one job; options: those of `svrgs prune` plus scene, colmap, out, report. Returns (exit status, result)."""
    above = str(Path(__file__).parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (above, os.environ.get("PYTHONPATH"))))}
    request = json.dumps({name: str(value) if isinstance(value, Path) else value for name, value in options.items()})
    before = signal.signal(signal.SIGINT, _wait_for_child)
    try:
        child = subprocess.run([sys.executable, "-m", "svrgs_addon.worker"], input=request, text=True, stdout=subprocess.PIPE, env=environment)
    finally:
        signal.signal(signal.SIGINT, before)
    try:
        return child.returncode, json.loads(child.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        return child.returncode or 1, {"error": f"the job ended without a result (exit status {child.returncode})"}


def _wait_for_child(*_):
    """Ctrl-C reaches the child as well, which stops cleanly. (A handler of ours, unlike SIG_IGN, is not inherited.)"""


def main() -> int:
    from .cli import guarded
    from .commands import plain, prune_one

    request = json.load(sys.stdin)
    options = argparse.Namespace(**{name: Path(value) if name in PATHS and value is not None else value for name, value in request.items()})
    result: dict = {}

    def job() -> int:
        result.update(prune_one(options))
        return 0

    status = guarded(job, lambda sentence: result.update(error=sentence))
    print(json.dumps(plain(result)), flush=True)
    return status


if __name__ == "__main__":
    sys.exit(main())
