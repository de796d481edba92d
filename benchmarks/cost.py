"""What a command costs: seconds, and the memory that it uses for itself."""

from __future__ import annotations

import subprocess
import sys
import time
from pathlib import Path

SVRGS = (sys.executable, "-m", "svrgs_addon")
POLL = 0.02  # seconds between two looks at the memory


def cost_of(*command: object) -> tuple[float, int]:
    """Runs the command. Returns its seconds and its largest anonymous memory in bytes; mapped files do not
    count. Raises SystemExit if it fails."""
    words = [str(word) for word in command]
    started, most = time.perf_counter(), 0
    root = Path(__file__).resolve().parents[1]
    with subprocess.Popen(words, stdout=subprocess.DEVNULL, cwd=root) as child:
        while child.poll() is None:
            most = max(most, anonymous(child.pid))
            time.sleep(POLL)
    if child.returncode:
        raise SystemExit(f"{' '.join(words)}: exit status {child.returncode}")
    return time.perf_counter() - started, most


def anonymous(pid: int) -> int:
    """Bytes of anonymous memory of a process; 0 when it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon")), 0)
