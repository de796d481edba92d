"""Exit status, error sentence and JSON result of a process.

Exit status 0: done. 1: failure of the program or the system. 2: wrong usage or input. 130: stopped by the user; the run can be resumed.
"""

from __future__ import annotations

import json
import logging
import math
import sys
from collections.abc import Callable

from .errors import Cancelled, NativeError, SplatError

STOPPED = 130


def guarded(run: Callable[[], int], tell: Callable[[str], None]) -> int:
    """Calls run() and returns its exit status. An expected error is passed to tell() as one sentence and becomes a status (see above).

    Other exceptions pass through.
    """
    try:
        return run()
    except SplatError as error:
        tell(str(error))
        return 2
    except Cancelled:
        tell("stopped; continue from the last checkpoint with --resume")
        return STOPPED
    except KeyboardInterrupt:
        tell("interrupted")
        return STOPPED
    except (NativeError, MemoryError, OSError) as error:
        tell(str(error) or "out of memory")
        return 1


def answer(work: Callable[[dict], dict]) -> int:
    """The main function of a child process: it gives work() the JSON object on stdin, and prints its result as JSON on stdout.

    An expected error is printed as {"error": sentence}. Returns the exit status.
    """
    logging.basicConfig(format="svrgs: %(message)s", level=logging.WARNING)
    request, result = json.load(sys.stdin), {}

    def run() -> int:
        result.update(work(request))
        return 0

    status = guarded(run, lambda sentence: result.update(error=sentence))
    print(json.dumps(plain(result)), flush=True)
    return status


def plain(value):
    """Returns the value in a form that JSON can store. Infinity and NaN become None, tuples become lists; containers are converted recursively."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
