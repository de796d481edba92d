"""The standard streams of the process: any text can be printed, also where they are closed or have another
encoding than UTF-8."""

from __future__ import annotations

import codecs
import io
import os
import sys

from ..system.exit_status import log_to_stderr

ERRORS = "svrgs"  # name of the error handler of both streams


def prepare() -> None:
    """Opens the standard streams that are closed, makes stdout and stderr take any text, and sends warnings
    to stderr."""
    _open_closed()
    codecs.register_error(ERRORS, _encode)
    for stream in (sys.stdout, sys.stderr):
        if isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors=ERRORS)
    log_to_stderr()


def _open_closed() -> None:
    """Opens the null device in place of closed streams. Otherwise the next file that is opened would be what
    libraries take for stderr."""
    for descriptor, name in enumerate(("stdin", "stdout", "stderr")):
        try:
            os.fstat(descriptor)
        except OSError:
            os.open(os.devnull, os.O_RDWR)  # takes the lowest free number, which is this one
        if getattr(sys, name) is None:
            setattr(sys, name, open(os.devnull, "r+", encoding="utf-8"))


def _encode(error: UnicodeError) -> tuple[bytes, int]:
    """The bytes of letters that an encoding lacks: bytes of a path that are not UTF-8 stay as they are, other
    letters are escaped."""
    if not isinstance(error, UnicodeEncodeError):
        raise error
    letters = error.object[error.start : error.end]
    coded = (
        os.fsencode(letter) if "\udc80" <= letter <= "\udcff" else letter.encode("ascii", "backslashreplace")
        for letter in letters
    )
    return b"".join(coded), error.end
