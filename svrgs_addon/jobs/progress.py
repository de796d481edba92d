"""What a person sees while a run goes on: a bar on a terminal, a line now and then elsewhere. Always stderr."""

from __future__ import annotations

import sys
import time

from ..finetune.loop import Progress

BAR_WIDTH = 24
TERMINAL_PAUSE, LOG_PAUSE = 0.2, 10.0  # seconds between updates


class Reporter:
    """Called after each step."""

    def __init__(self, quiet: bool = False):
        self.quiet = quiet
        self.terminal = sys.stderr.isatty()
        self._next = 0.0

    def __call__(self, p: Progress):
        now = time.monotonic()
        last = p.iteration == p.total
        if self.quiet or (now < self._next and not last):
            return
        self._next = now + (TERMINAL_PAUSE if self.terminal else LOG_PAUSE)
        text = describe(p)
        if self.terminal:
            print(f"\r{bar(p.iteration / p.total)} {text}\x1b[K", end="\n" if last else "", file=sys.stderr, flush=True)
        else:
            print(text, file=sys.stderr, flush=True)


def bar(share: float) -> str:
    filled = int(share * BAR_WIDTH)
    return "[" + "#" * filled + "." * (BAR_WIDTH - filled) + "]"


def describe(p: Progress) -> str:
    minutes, seconds = divmod(int(p.seconds_left), 60)
    return f"{p.phase} {p.iteration}/{p.total}  {p.iterations_per_second:.1f} it/s  {p.count:,} Gaussians  loss {p.loss:.4f}  {minutes}:{seconds:02d} left"
