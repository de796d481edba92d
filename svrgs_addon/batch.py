"""The command line inside Blender: `blender -b --python svrgs_addon/batch.py -- prune SCENE… --out DIR`.

Any verb works. `prune` prints one JSON line a scene, skips finished scenes unless --overwrite, reports a failing scene and
goes on with the rest, and ends non-zero if any failed. The work runs in a child of Blender's own Python: what the
libraries need cannot clash with Blender's, and a crash cannot take Blender down. Runs under plain Python too.
"""

import os
import signal
import subprocess
import sys
from pathlib import Path


def main() -> int:
    words = sys.argv[sys.argv.index("--") + 1 :] if "--" in sys.argv else sys.argv[1:]
    if words[:1] == ["prune"]:
        words = [*words, "--batch"]
    above = str(Path(__file__).resolve().parents[1])
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, (above, os.environ.get("PYTHONPATH"))))}
    child = subprocess.Popen([sys.executable, "-m", "svrgs_addon", *words], env=environment)
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop(child))
    return child.wait()


def stop(child: subprocess.Popen):
    """Asks for a clean stop. A terminal's Ctrl-C reaches the child too, which does no harm; on Windows it is the only way."""
    if os.name == "posix":
        child.terminate()


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.exit(status)
