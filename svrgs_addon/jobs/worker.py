"""One pruning job of a batch in a child process. A crash or a lack of memory then ends this job and not the
batch.

Parent: run_in_child(). Child: `python -m svrgs_addon.jobs.worker`. It reads the options as one JSON object
from stdin and writes the result, or {"error": sentence}, as one JSON object to stdout; progress and warnings
go to stderr.
"""

from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ..prune.options import PruneOptions
from ..prune.stop_request import StopRequest
from ..system.exit_status import STOPPED, answer
from ..system.option_kinds import options_of
from ..system.processes import ChildProcess
from ..system.subprocess_python import environment

OF_OPTIONS = (name for name, option in options_of(PruneOptions).items() if option.kind.type is Path)
PATHS = ("scene", "out", "report", *OF_OPTIONS)


def run_in_child(options: PruneOptions) -> tuple[int, dict]:
    """Runs one job. Returns (exit status, result).

    The status is STOPPED if a stop was requested, even if the job still finished and its result is complete.
    """
    request = json.dumps(asdict(options), default=str)  # paths as text
    command = [sys.executable, "-m", "svrgs_addon.jobs.worker"]
    with ChildProcess(
        command, encoding="utf-8", stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment()
    ) as child:
        with StopRequest(child.ask_to_stop) as stop:
            try:
                output, _ = child.communicate(request)
            except BaseException:  # a second Ctrl-C
                child.kill()
                raise
    status = STOPPED if stop.asked else child.returncode
    try:
        return status, json.loads(output.splitlines()[-1])
    except (IndexError, ValueError):
        return status or 1, {"error": f"the job ended without a result (exit status {child.returncode})"}


def _prune_request(request: dict) -> dict:
    from ..prune.pipeline import prune_scene

    values: dict[str, Any] = {
        name: Path(value) if name in PATHS and value is not None else value for name, value in request.items()
    }
    # JSON has no tuples
    values |= {name: tuple(value) for name, value in values.items() if isinstance(value, list)}
    return prune_scene(PruneOptions(**values))


if __name__ == "__main__":
    sys.exit(answer(_prune_request))
