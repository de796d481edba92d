"""Child processes of the Python that runs this process, in Blender those of Blender's own Python.

Work that could end the process runs here: libraries that conflict with those of Blender, or a crash, cannot
end Blender.
"""

from __future__ import annotations

import contextlib
import json
import os
import subprocess
import sys
import tempfile
from collections.abc import Callable, Mapping
from pathlib import Path

from .errors import SceneError
from .packages import MISSING_VARIABLE
from .processes import ChildProcess
from .wheels import ROOT, importable, missing


def run(
    words: list[str],
    module: str = "svrgs_addon",
    request: dict | None = None,
    capture: bool = True,
    progress: Callable[..., None] = lambda *_: None,
) -> tuple[int, dict]:
    """Runs `python -m MODULE WORDS…` and waits for it. Returns (exit status, JSON object in the last line of
    its stdout).

    request: sent as JSON to its stdin. For an exit status that is not 0, the object has an "error"; without
    one on stdout, that is the last line of stderr. capture=False: the child process uses stdout and stderr of
    this process, and the object is {}. progress: called with the values of each line {"progress": [value,
    …]} as it comes.
    """
    command = [sys.executable, "-m", module, *words]
    asked = json.dumps(request) if request is not None else ""
    if not capture:
        with ChildProcess(command, env=environment(), encoding="utf-8", stdin=subprocess.PIPE) as child:
            child.communicate(asked)
        return child.returncode, {}
    last, pipe = "", subprocess.PIPE
    # of the three streams, which are read here and nowhere else
    variables = environment() | {"PYTHONIOENCODING": "utf-8"}
    with tempfile.TemporaryFile("w+", encoding="utf-8", errors="replace") as errors:
        with ChildProcess(
            command, env=variables, encoding="utf-8", errors="replace", stdin=pipe, stdout=pipe, stderr=errors
        ) as child:
            assert child.stdin is not None and child.stdout is not None
            with contextlib.suppress(OSError):  # it ended without reading
                child.stdin.write(asked)
                child.stdin.close()
            for last in child.stdout:
                if last.startswith('{"progress"'):
                    progress(*json.loads(last)["progress"])
        errors.seek(0)
        error_lines = [line.strip() for line in errors if line.strip()]
    return child.returncode, _result(child.returncode, last, error_lines)


def ask(
    words: list[str],
    module: str = "svrgs_addon",
    request: dict | None = None,
    progress: Callable[..., None] = lambda *_: None,
) -> dict:
    """As run(), where only the object counts. Raises SceneError with its error for a status that is not 0."""
    status, result = run(words, module, request, progress=progress)
    if status:
        raise SceneError(result["error"])
    return result


def _result(status: int, last: str, error_lines: list[str]) -> dict:
    found = None
    with contextlib.suppress(ValueError):
        found = json.loads(last)
    result = found if isinstance(found, dict) else {}
    if status and not result.get("error"):
        text = f"the process ended without a result (exit status {status})"
        result["error"] = error_lines[-1].removeprefix("svrgs: ") if error_lines else text
    return result


def environment(packages: Mapping[str, Path] | None = None) -> dict[str, str]:
    """The environment variables of this process, with a PYTHONPATH on which a child process finds this
    package and those it needs, and with what to do about missing ones. Files in the current folder, such as a
    json.py, are not taken for modules. packages: {package: its folder}; None: where this process finds
    them."""
    found = importable() if packages is None else packages
    paths = [ROOT, *found.values(), os.environ.get("PYTHONPATH")]
    remedy = os.environ.get(MISSING_VARIABLE) or missing(found)
    path = os.pathsep.join(dict.fromkeys(str(path) for path in paths if path))
    return {**os.environ, "PYTHONPATH": path, "PYTHONSAFEPATH": "1", MISSING_VARIABLE: remedy}
