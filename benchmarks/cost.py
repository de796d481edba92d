"""What a command costs: seconds, and the memory that it uses for itself."""

from __future__ import annotations

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[1]
SVRGS = (sys.executable, "-m", "svrgs_addon")
POLL = 0.02  # seconds between two looks at the memory


def svrgs(*words: object) -> dict:
    """The result of a command of svrgs. Raises SystemExit if it fails."""
    return result_and_cost(*words)[0]


def result_and_cost(*words: object) -> tuple[dict, float, int]:
    """The result of a command of svrgs, its seconds, and its memory as cost_of() measures it."""
    with tempfile.TemporaryFile("w+") as file:
        seconds, memory = cost_of(*SVRGS, *words, "--json", stdout=file)
        file.seek(0)
        return json.load(file), seconds, memory


def cost_of(*command: object, stdout: Any = subprocess.DEVNULL) -> tuple[float, int]:
    """Runs the command. Returns its seconds and its largest anonymous memory in bytes; mapped files do not
    count. stdout: where its output goes. If it fails, raises SystemExit with the last line of stderr."""
    words = [str(word) for word in command]
    started, most = time.perf_counter(), 0
    with tempfile.TemporaryFile("w+") as said:
        with subprocess.Popen(words, stdout=stdout, stderr=said, cwd=ROOT) as child:
            while child.poll() is None:
                most = max(most, anonymous(child.pid))
                time.sleep(POLL)
        if child.returncode:
            said.seek(0)
            last = (said.read().strip().splitlines() or ["no message"])[-1]
            raise SystemExit(f"{' '.join(words)}: exit status {child.returncode}: {last}")
    return time.perf_counter() - started, most


def anonymous(pid: int) -> int:
    """Bytes of anonymous memory of a process; 0 when it has ended."""
    try:
        lines = Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0
    return next((1024 * int(line.split()[1]) for line in lines if line.startswith("RssAnon")), 0)
