"""`svrgs` and `python -m svrgs_addon`: parse, run, one sentence on stderr where it fails.

Exit 0: done. 1: failure. 2: usage or input. 130: stopped by the user, resumable.
"""

from __future__ import annotations

import logging
import sys

from .arguments import parser
from .errors import Cancelled, NativeError, SplatError


def main(arguments: list[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    logging.basicConfig(format="svrgs: %(message)s", level=logging.WARNING)
    options = parser().parse_args(arguments)
    try:
        from . import commands, native

        if options.threads:
            native.set_threads(options.threads)
        return commands.COMMANDS[options.command](options)
    except SplatError as error:
        return _fail(str(error), 2)
    except (Cancelled, KeyboardInterrupt):
        return _fail("stopped; what was written so far is whole, --resume goes on from the last checkpoint", 130)
    except (NativeError, MemoryError, OSError) as error:
        return _fail(str(error) or type(error).__name__, 1)


def _fail(sentence: str, status: int) -> int:
    print(f"svrgs: {sentence}", file=sys.stderr)
    return status
