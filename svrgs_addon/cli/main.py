"""The entry point of `svrgs` and `python -m svrgs_addon`: it parses the arguments and runs the command.

An error is one sentence on stderr. exit_status.py lists the exit codes. Modules are imported inside main(),
which answers Ctrl-C.
"""

from __future__ import annotations

import sys


def main(arguments: list[str] | None = None) -> int:
    """Runs one command and returns the exit status. arguments: None takes those of the process."""
    try:
        return _main(arguments)
    except KeyboardInterrupt:  # before guarded()
        print("svrgs: interrupted", file=sys.stderr)
        return 130


def _main(arguments: list[str] | None) -> int:
    from . import terminal

    terminal.prepare()
    from ..system import memory
    from ..system.exit_status import guarded
    from ..system.packages import uninterrupted
    from .arguments import parser

    options = parser().parse_args(arguments)

    def run() -> int:
        memory.refuse_few_addresses(
            memory.NUMPY_ADDRESSES if options.command == "info" else memory.PHOTOGRAPH_ADDRESSES
        )
        with uninterrupted():  # NumPy is imported here
            from . import commands

        return commands.COMMANDS[options.command](options)

    return guarded(run, lambda sentence: print(f"svrgs: {sentence}", file=sys.stderr))
