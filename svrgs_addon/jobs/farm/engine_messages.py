"""Progress in the words of an engine. Open Job Description reads lines of stdout: openjd_progress with
percent, openjd_status, openjd_fail."""

from __future__ import annotations

import sys
import time
from dataclasses import dataclass, field, replace

PAUSE = 1.0  # seconds between two lines about the progress
KINDS = ("text", "openjd")


@dataclass
class Messages:
    """Tells the progress of a part of the work. kind: of KINDS; text goes to stderr."""

    kind: str
    start: float = 0.0  # of the part, as a share of the work
    length: float = 1.0
    _next: float = field(default=0.0, repr=False)

    def within(self, place: int, count: int) -> Messages:
        """For one of `count` equal parts of this part."""
        return replace(self, start=self.start + place * self.length / count, length=self.length / count)

    def progress(self, text: str, share: float):
        """As tell(), not more often than every second."""
        if time.monotonic() >= self._next:
            self._next = time.monotonic() + PAUSE
            self.tell(text, share)

    def tell(self, text: str, share: float):
        """share: of this part that is done, 0 to 1."""
        percent = 100 * (self.start + share * self.length)
        if self.kind == "openjd":
            print(f"openjd_status: {text}\nopenjd_progress: {percent:.2f}", flush=True)
        else:
            print(f"{percent:5.1f} %  {text}", file=sys.stderr, flush=True)

    def fail(self, sentence: str):
        """Tells why the work ends; plain text is left to the command, which tells errors on stderr."""
        if self.kind == "openjd":
            print(f"openjd_fail: {sentence}", flush=True)
