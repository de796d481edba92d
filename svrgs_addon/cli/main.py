"""`svrgs` and `python -m svrgs_addon`: parse, run, one sentence on stderr where it fails.

exit_status.py lists the exit codes.
"""

from __future__ import annotations

import logging
import sys

from ..exit_status import guarded
from .arguments import parser


def main(arguments: list[str] | None = None) -> int:
    """Runs one command; returns the exit status."""
    logging.basicConfig(format="svrgs: %(message)s", level=logging.WARNING)
    options = parser().parse_args(arguments)

    def run() -> int:
        from . import commands

        return commands.COMMANDS[options.command](options)

    return guarded(run, lambda sentence: print(f"svrgs: {sentence}", file=sys.stderr))
