"""Keeps Blender's messages off the terminal and prints progress there instead."""

import ctypes
import os
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

LINES = 4  # of progress, where a line cannot be written over


@contextmanager
def captured(log: Path) -> Iterator[TextIO]:
    """Whatever this process prints goes into `log`, also what its libraries print. Yields the true stderr.

    The log is shown there if the block fails.
    """
    kept = os.dup(1), os.dup(2)
    with open(kept[1], "w", encoding="utf-8", closefd=False) as terminal, open(log, "wb") as file:
        _point((file.fileno(), file.fileno()))
        try:
            yield terminal
        except BaseException:
            _point(kept)
            terminal.write(log.read_text(encoding="utf-8", errors="replace"))
            raise
        finally:
            _point(kept)
    for number in kept:
        os.close(number)


def _point(targets: tuple[int, int]) -> None:
    """Let stdout and stderr lead to these descriptors. What was printed before still goes where it
    belongs."""
    sys.stdout.flush()
    sys.stderr.flush()
    ctypes.CDLL(None).fflush(None)
    os.dup2(targets[0], 1)
    os.dup2(targets[1], 2)


def progress(stream: TextIO, what: str) -> Callable[[int, int], None]:
    """A function of how much is done and of how much: it advances one line on a terminal, elsewhere it prints
    a few lines."""

    def show(done: int, of: int) -> None:
        text = f"{what}: {done} of {of} views"
        if stream.isatty():
            print(f"\r{text}", end="" if done < of else "\n", file=stream, flush=True)
        elif done * LINES // of > (done - 1) * LINES // of:
            print(text, file=stream, flush=True)

    return show
