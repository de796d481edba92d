"""A clean stop on Ctrl-C and the other signals of system.processes.stop_signals()."""

from __future__ import annotations

import contextlib
import os
import signal
from collections.abc import Callable

from ..system.processes import stop_signals


class StopRequest:
    """A context manager. Within its block, the signals of stop_signals() request a clean stop; a second
    Ctrl-C interrupts at once.

    Calling the object returns whether a stop was requested. tell: called at the first request, within the
    signal handler.
    """

    def __init__(self, tell: Callable[[], None] | None = None):
        self.asked = False
        self._tell = tell or _announce

    def __enter__(self) -> StopRequest:
        self._old = {s: signal.signal(s, self._ask) for s in stop_signals()}
        return self

    def __exit__(self, *_):
        for number, handler in self._old.items():
            signal.signal(number, handler)

    def __call__(self) -> bool:
        return self.asked

    def _ask(self, number: int, _frame):
        told, self.asked = self.asked, True
        if number == signal.SIGINT:
            signal.signal(signal.SIGINT, signal.default_int_handler)
        if not told:
            self._tell()


def _announce():
    with contextlib.suppress(OSError):
        # not print(), which the signal may have interrupted
        os.write(2, b"\nstopping after this step; press Ctrl-C again to stop at once\n")
