"""Child processes of the Python that runs this process, in Blender those of Blender's own Python.

Work that could end the process runs here: libraries that conflict with those of Blender, or a crash, cannot end Blender.
"""

from __future__ import annotations

import json
import os
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path

from .packages import ROOT, importable


def run(words: list[str], module: str = "svrgs_addon", request: dict | None = None, capture: bool = True) -> tuple[int, dict]:
    """Runs `python -m MODULE WORDS…` and waits for it. Returns (exit status, JSON object in the last line of its stdout).

    request: sent as JSON to its stdin. If there is no JSON, the object is {"error": last line of stderr} for an exit status that is
    not 0, else {}. capture=False: the child process uses stdout and stderr of this process, and the object is {}.
    """
    pipe = subprocess.PIPE if capture else None
    done = subprocess.run(
        [sys.executable, "-m", module, *words], env=environment(), text=True, input=json.dumps(request) if request is not None else "", stdout=pipe, stderr=pipe
    )
    if not capture:
        return done.returncode, {}
    try:
        return done.returncode, json.loads(done.stdout.splitlines()[-1])
    except (IndexError, ValueError):
        error_lines = [line for line in done.stderr.splitlines() if line.strip()]
        reason = error_lines[-1].removeprefix("svrgs: ") if error_lines else f"the process ended without a result (exit status {done.returncode})"
        return done.returncode, {"error": reason} if done.returncode else {}


def environment(packages: Mapping[str, Path] | None = None) -> dict[str, str]:
    """The environment variables of this process, with a PYTHONPATH on which a child process finds this package and those it needs.

    packages: {package: its folder}. Default: where this process finds them.
    """
    paths = [ROOT, *(importable() if packages is None else packages).values(), os.environ.get("PYTHONPATH")]
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(str(path) for path in paths if path))}
