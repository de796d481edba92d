"""Processes of the Python that runs this one, Blender's too: a library that clashes with Blender's own, or a crash, cannot take Blender down."""

from __future__ import annotations

import importlib.util
import json
import os
import subprocess
import sys
from pathlib import Path

PACKAGES = ("numpy", "OpenImageIO", "pycolmap")  # wherever this process would find them, the child does


def run(words: list[str], module: str = "svrgs_addon", request: dict | None = None, capture: bool = True) -> tuple[int, dict]:
    """Runs `python -m MODULE WORDS…`; returns (exit status, the JSON object of its last line on stdout, or {}).

    request: sent as JSON on stdin. capture: else stdout is this process's, and the object {}. Where no JSON comes and the
    status is not 0, the object is {"error": last line on stderr}.
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
        said = [line for line in done.stderr.splitlines() if line.strip()]
        reason = said[-1].removeprefix("svrgs: ") if said else f"the process ended without a result (exit status {done.returncode})"
        return done.returncode, {"error": reason} if done.returncode else {}


def environment() -> dict[str, str]:
    """This process's environment, in which a child finds this package and the PACKAGES."""
    found = [str(Path(__file__).parents[2])]
    for name in PACKAGES:
        spec = importlib.util.find_spec(name)
        if spec is not None and spec.submodule_search_locations:
            found.append(str(Path(next(iter(spec.submodule_search_locations))).parent))
    if os.environ.get("PYTHONPATH"):
        found.append(os.environ["PYTHONPATH"])
    return {**os.environ, "PYTHONPATH": os.pathsep.join(dict.fromkeys(found))}
