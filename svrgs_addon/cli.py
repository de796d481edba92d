"""`svrgs` and `python -m svrgs_addon`: parse, run, one sentence on stderr where it fails.

Exit 0: done. 1: failure. 2: usage or input. 130: stopped by the user, resumable.
"""

from __future__ import annotations

import logging
import sys
from collections.abc import Callable

from .arguments import parser
from .errors import Cancelled, NativeError, SplatError

STOPPED = 130


def main(arguments: list[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    logging.basicConfig(format="svrgs: %(message)s", level=logging.WARNING)
    options = parser().parse_args(arguments)

    def run() -> int:
        from . import commands

        return commands.COMMANDS[options.command](options)

    return guarded(run, lambda sentence: print(f"svrgs: {sentence}", file=sys.stderr))


def guarded(run: Callable[[], int], tell: Callable[[str], None]) -> int:
    """The exit status of run(); an error becomes one sentence for tell() and its status."""
    try:
        return run()
    except SplatError as error:
        tell(str(error))
        return 2
    except Cancelled:
        tell("stopped; --resume goes on from the last checkpoint")
        return STOPPED
    except KeyboardInterrupt:
        tell("interrupted")
        return STOPPED
    except (NativeError, MemoryError, OSError) as error:
        tell(str(error) or "out of memory")
        return 1
