"""`python -m tests.instruction_counts`: counts, beside those recorded; with --record, they become the
recorded ones."""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from instruction_counts import RECORD, builder, measure, missing, record, recorded


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.instruction_counts", description=__doc__)
    parser.add_argument("--record", action="store_true", help=f"write them to {RECORD.name}")
    options = parser.parse_args()
    if reason := missing():
        print(reason, file=sys.stderr)
        return 1
    before = recorded()["counts"] if RECORD.exists() else {}
    with tempfile.TemporaryDirectory() as folder:
        counts = measure(Path(folder))
    print(builder())
    for name, count in counts.items():
        print(
            f"{name:20} {count:12,}" + (f"  {count / before[name] - 1:+.1%}" if name in before else "  new")
        )
    if options.record:
        record(counts)
    return 0


if __name__ == "__main__":
    sys.exit(main())
