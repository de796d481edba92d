"""A child process that runs one build of the native library on a generated room, one request at a time.

Requests come on stdin and answers go to stdout, one JSON object per line. The request {"level": name or null}
is answered by {"forward": seconds, "step": seconds} or {"error": sentence}. With "save": FILE, the image is
written there first.
"""

from __future__ import annotations

import contextlib
import json
import subprocess
import sys
from pathlib import Path

import numpy as np

from svrgs_addon.native import library
from svrgs_addon.native.library_path import LIBRARY_VARIABLE
from svrgs_addon.system import subprocess_python
from svrgs_addon.system.errors import NativeError
from svrgs_addon.system.exit_status import use_utf_8
from svrgs_addon.system.processes import ChildProcess

from .cases import Case, room_case
from .timing import seconds
from .trial import Trial


class Child:
    """The parent's side. It starts the process with the library `built` (None: the installed one) and sends
    requests."""

    def __init__(self, case: Case, built: Path | None = None):
        variables = subprocess_python.environment()
        if built:
            variables[LIBRARY_VARIABLE] = str(built)
        facts = [case.facts[name] for name in ("count", "sh_degree", "width", "height")]
        command = [sys.executable, "-m", "svrgs_bench.child", *map(str, (library.threads(), *facts))]
        process = ChildProcess(
            command, encoding="utf-8", env=variables, stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert process.stdin is not None and process.stdout is not None
        self._process, self._requests, self._answers = process, process.stdin, process.stdout

    def ask(self, **request) -> dict:
        """The answer to a request. Raises NativeError if it is an error or if the process has ended."""
        try:
            self._requests.write(json.dumps(request) + "\n")
            self._requests.flush()
            answer = json.loads(self._answers.readline())
        except (OSError, ValueError):
            raise NativeError("a child process of the measurement ended before it answered") from None
        if "error" in answer:
            raise NativeError(answer["error"])
        return answer

    def image(self, folder: Path, **request) -> np.ndarray:
        """The image that the child renders, (H, W, 3)."""
        path = folder / "image.npy"
        self.ask(**request, save=str(path))
        return np.load(path)

    def __enter__(self) -> Child:
        return self

    def __exit__(self, *_):
        with contextlib.suppress(OSError):  # the process may have ended
            self._requests.close()
        self._process.wait()
        self._answers.close()


def main(words: list[str]):
    use_utf_8()
    threads, *facts = map(int, words)
    library.set_threads(threads)
    case = room_case(*facts)
    trials: dict[str | None, Trial] = {}
    for line in sys.stdin:
        request = json.loads(line)
        level = request["level"]
        try:
            trials[level] = trials.get(level) or Trial(case, level)
            answer = _answer(trials[level], request)
        except (NativeError, TypeError) as error:  # the build or the level does not support the request
            answer = {"error": str(error)}
        print(json.dumps(answer), flush=True)


def _answer(trial: Trial, request: dict) -> dict:
    if "save" in request:
        np.save(request["save"], trial.forward()["rgb"])
    forward = seconds(trial.forward)
    return {"forward": forward, "step": seconds(trial.step)}


if __name__ == "__main__":
    main(sys.argv[1:])
