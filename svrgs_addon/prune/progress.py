"""Progress of a run on stderr: a bar in a terminal, otherwise one line every 10 seconds."""

from __future__ import annotations

import shutil
import sys
import time

from ..finetune.loop import Progress

BAR_WIDTH = 24
TERMINAL_PAUSE, LOG_PAUSE = 0.2, 10.0  # seconds between updates


class Reporter:
    """An observer that prints progress. It is called after each step. quiet: it prints nothing."""

    def __init__(self, quiet: bool = False):
        self.quiet = quiet
        self.terminal = sys.stderr.isatty()
        self._next = 0.0
        self._width = 0  # characters of the last line in the terminal

    def say(self, sentence: str):
        """Prints a sentence before the first step."""
        if not self.quiet:
            print(sentence, file=sys.stderr, flush=True)

    def __call__(self, p: Progress):
        self.part(describe(p), p.iteration / p.total)

    def part(self, text: str, share: float):
        """Prints the text and, in a terminal, a bar. share: how much of the work is done, 0 to 1."""
        now, last = time.monotonic(), share == 1
        if self.quiet or (now < self._next and not last):
            return
        self._next = now + (TERMINAL_PAUSE if self.terminal else LOG_PAUSE)
        if self.terminal:
            line = _fitting(f"{bar(share)} {text}", text)
            # spaces clear the rest of a longer line: not every console of Windows knows escapes
            padded = f"{line:{self._width}}"
            print(f"\r{padded}", end="\n" if last else "", file=sys.stderr, flush=True)
            self._width = len(line)
        else:
            print(text, file=sys.stderr, flush=True)


def _fitting(*lines: str) -> str:
    """The first line that is narrower than the terminal, else the beginning of the last one: a line that
    wraps cannot be replaced."""
    columns = shutil.get_terminal_size().columns
    return next((line for line in lines if len(line) < columns), lines[-1][: columns - 1])


def bar(share: float) -> str:
    """A progress bar. share: 0..1."""
    filled = int(share * BAR_WIDTH)
    return "[" + "#" * filled + "." * (BAR_WIDTH - filled) + "]"


def describe(p: Progress) -> str:
    """One line: phase, step, speed, number of Gaussians, loss and time left."""
    minutes, seconds = divmod(int(p.seconds_left), 60)
    return (
        f"{p.phase} {p.iteration}/{p.total}  {p.iterations_per_second:.1f} it/s  {p.count:,} Gaussians  loss"
        f" {p.loss:.4f}  {minutes}:{seconds:02d} left"
    )
