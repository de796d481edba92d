"""The command line inside Blender: `blender -b --python svrgs_addon/batch.py -- prune SCENE… --out DIR`.

Any verb works. `prune` prints one JSON line a scene, skips finished scenes unless --overwrite, reports a failing scene and
goes on with the rest, and ends non-zero if any failed. The work runs in a child of Blender's own Python: what the
libraries need cannot clash with Blender's, and a crash cannot take Blender down. Runs under plain Python too.
"""

import os
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
    while True:
        try:
            return child.wait()
        except KeyboardInterrupt:  # the child got it too and finishes its step
            continue


if __name__ == "__main__":
    status = main()
    sys.stdout.flush()
    sys.exit(status)
