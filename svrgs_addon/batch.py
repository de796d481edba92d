"""The command line inside Blender: `blender -b --python svrgs_addon/batch.py -- prune SCENE… --out DIR`.

Any command works. `prune` prints one JSON line per scene and skips finished scenes unless --overwrite is given. If a scene
fails, it reports the scene, continues with the others, and exits with a status that is not 0. The work runs in a child process of
Blender's own Python: its libraries cannot conflict with those of Blender, and a crash cannot end Blender. The script runs under
plain Python too.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path


def main() -> int:
    """Starts the child process and waits for it. Returns its exit status."""
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if words[:1] == ["prune"]:
        words = [*words, "--batch"]
    root = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (root, os.environ.get("PYTHONPATH"))))}
    child = subprocess.Popen([sys.executable, "-m", "svrgs_addon", *words], env=environment)
    numbers = [signal.SIGINT, signal.SIGTERM]
    if hasattr(signal, "SIGHUP") and signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:  # not on Windows, and not under nohup
        numbers.append(signal.SIGHUP)
    for number in numbers:
        signal.signal(number, lambda *_: stop(child))
    return child.wait()


def stop(child: subprocess.Popen):
    """Asks the child process to stop cleanly (SIGTERM on POSIX).

    Ctrl-C in a terminal reaches the child directly as well, which is harmless. On Windows, Ctrl-C is the only way.
    """
    if os.name == "posix":
        child.terminate()


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.exit(status)
