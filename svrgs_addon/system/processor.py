"""The processor: its cores, apart from the two threads that some of them run at once."""

from __future__ import annotations

import os
from pathlib import Path

TOPOLOGY = Path("/sys/devices/system/cpu")


def cores() -> int | None:
    """The number of cores that this process may use. Two threads of one core (SMT) count once. None if that
    is not known, which it is on Linux alone."""
    try:
        siblings = {
            (TOPOLOGY / f"cpu{number}/topology/thread_siblings_list").read_text().strip()
            for number in os.sched_getaffinity(0)
        }
    except (AttributeError, OSError):
        return None
    return len(siblings)
