"""Frame times of a Solid viewport while the view moves, with two sizes of splats. Writes them to
OUT/seen.json."""

from __future__ import annotations

import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))

import driver
from driver import OUT, shot

import viewport

SIZES = (196_000, 1_500_000)  # Gaussians


def steps():
    seen: dict = {}
    for count in SIZES:
        seen[str(count)] = yield from viewport.measure(count)
        shot(f"moving-{count}")
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())
