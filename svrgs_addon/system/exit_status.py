"""Exit status, error sentence and JSON result of a process.

Exit status 0: done. 1: failure of the program or the system. 2: wrong usage or input. 130: stopped by the
user; the run can be resumed.
"""

from __future__ import annotations

import io
import json
import logging
import math
import os
import re
import sys
from collections.abc import Callable

from .errors import Cancelled, NativeError, SplatError
from .file_names import shown
from .packages import import_reason

STOPPED = 130
LONGEST, KEPT = 2000, 900  # characters of a sentence; of each end of a longer one, which quotes a file
# of ASCII and Latin-1, separators of lines and paragraphs, changes of the writing direction
CONTROLS = re.compile("[\x00-\x1f\x7f-\x9f\u2028\u2029\u202a-\u202e\u2066-\u2069]")


def guarded(run: Callable[[], int], report: Callable[[str], None]) -> int:
    """Calls run() and returns its exit status. An expected error is passed to report() as one sentence and
    becomes a status (see above). Other exceptions pass through."""
    try:
        return run()
    except SplatError as error:
        report(printable(str(error)))
        return 2
    except Cancelled as stopped:
        report(str(stopped) or "stopped; continue from the last checkpoint with --resume")
        return STOPPED
    except KeyboardInterrupt:
        report("interrupted")
        return STOPPED
    except ImportError as error:
        report(f"the package {error.name or 'that is needed'} cannot be loaded ({import_reason(error)})")
    except MemoryError as error:
        report("out of memory" + (f": {printable(str(error))}" if str(error) else ""))
    except SystemError as error:  # of NumPy, where a small piece of memory was not to be had
        if "without setting an exception" not in str(error):
            raise
        report("out of memory")
    except BrokenPipeError:  # whoever read stdout has heard enough, as head
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except (NativeError, OSError) as error:
        report(printable(str(error)))
    except RuntimeError as error:
        if "start new thread" not in str(error):
            raise
        report(
            "no further thread can be started: memory or the number of threads is limited (ulimit -v, -u);"
            " raise the limit, or use fewer --threads"
        )
    return 1


def printable(text: str) -> str:
    """The text with control characters as escapes such as \\x1b, so that a name in it cannot command the
    terminal or add a line, and without the middle if it is very long. Paths are as the user wrote them."""
    if len(text) > LONGEST:
        text = f"{text[:KEPT]} … {text[-KEPT:]}"
    return CONTROLS.sub(lambda found: found[0].encode("unicode_escape").decode(), shown(text))


class OneLine(logging.Formatter):
    """One line for each record, without control characters."""

    def format(self, record: logging.LogRecord) -> str:
        return printable(super().format(record))


def log_to_stderr() -> None:
    """Sends warnings of this process to stderr, as sentences of svrgs."""
    handler = logging.StreamHandler()
    handler.setFormatter(OneLine("svrgs: %(message)s"))
    logging.basicConfig(handlers=[handler], level=logging.WARNING)


def use_utf_8() -> None:
    """From here on stdin and stdout, pipes to another process of this product, are UTF-8 in any locale."""
    for stream in (sys.stdin, sys.stdout):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(encoding="utf-8")


def answer(work: Callable[[dict], dict]) -> int:
    """The main function of a child process: it gives work() the JSON object on stdin, and prints its result
    as JSON on stdout, or an expected error as {"error": sentence}. Returns the exit status."""
    log_to_stderr()
    use_utf_8()
    request, result = json.load(sys.stdin), {}

    def run() -> int:
        result.update(work(request))
        return 0

    status = guarded(run, lambda sentence: result.update(error=sentence))
    print(json.dumps(plain(result)), flush=True)
    return status


def plain(value):
    """Returns the value in a form that JSON can store. Infinity and NaN become None, tuples become lists;
    containers are converted recursively. Paths in texts are as the user wrote them."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    if isinstance(value, str):
        return shown(value)
    return None if isinstance(value, float) and not math.isfinite(value) else value
