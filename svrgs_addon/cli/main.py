"""The entry point of `svrgs` and `python -m svrgs_addon`: it parses the arguments and runs the command.

An error is one sentence on stderr. exit_status.py lists the exit codes.
"""

from __future__ import annotations

import logging
import sys

from ..exit_status import guarded
from .arguments import parser


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns the exit status. arguments: None takes those of the process."""
    logging.basicConfig(format="svrgs: %(message)s", level=logging.WARNING)
    options = parser().parse_args(arguments)

    def run() -> int:
        from . import commands

        return commands.COMMANDS[options.command](options)

    return guarded(run, lambda sentence: print(f"svrgs: {sentence}", file=sys.stderr))
