"""How a process ends: its exit status, and its errors and results as others read them.

Exit 0: done. 1: failure. 2: usage or input. 130: stopped by the user, resumable.
"""

from __future__ import annotations

import math
from collections.abc import Callable

from .errors import Cancelled, NativeError, SplatError

STOPPED = 130


def guarded(run: Callable[[], int], tell: Callable[[str], None]) -> int:
    """The exit status of run(). An error becomes one sentence for tell() and its status."""
    try:
        return run()
    except SplatError as error:
        tell(str(error))
        return 2
    except Cancelled:
        tell("stopped; --resume goes on from the last checkpoint")
        return STOPPED
    except KeyboardInterrupt:
        tell("interrupted")
        return STOPPED
    except (NativeError, MemoryError, OSError) as error:
        tell(str(error) or "out of memory")
        return 1


def plain(value):
    """The value as JSON can hold it: infinity and NaN become null."""
    if isinstance(value, dict):
        return {k: plain(v) for k, v in value.items()}
    if isinstance(value, list | tuple):
        return [plain(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
