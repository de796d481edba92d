"""`python -m tests.digests`: runs the native core of every target that can be run here, and compares it with
this checkout's own, built by another compiler; with --record, what the levels in RECORDED_LEVELS give is
written to digests.txt. The exit status is 1 if anything differs.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from digests import (
    RECORD,
    RECORDED_LEVELS,
    TARGETS,
    build,
    cross_build,
    differences,
    lines,
    missing,
    recorded,
)
from svrgs_addon.native import library


def of_target(target: str, own: dict[str, list[str]]) -> tuple[dict[str, list[str]], bool]:
    """The lines of a target by level, and whether they are those expected."""
    levels, runner = TARGETS[target]
    program, found, right = cross_build(target), {}, True
    for level in (level for level in levels if level in own or level == "neon"):
        try:
            found[level] = lines(program, level, runner)
            wrong = differences(found[level], own.get(level) or recorded(level))
        except RuntimeError as error:
            wrong = [str(error)]
        print(
            f"{target:24} {level:9} {len(found.get(level, []))} lines,"
            f" {'the same' if not wrong else 'different:'}",
            flush=True,
        )
        print("".join(f"  {line}\n" for line in wrong), end="")
        right &= not wrong
    return found, right


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.digests", description=__doc__)
    parser.add_argument("--record", action="store_true", help=f"write {RECORD.name}; needs all targets")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        program = build(Path(folder))
        found = {level: lines(program, level) for level in library.supported_levels()}
    own, right = dict(found), True
    for target in TARGETS:
        if reason := missing(target):
            print(f"{target}: skipped, {reason}")
            continue
        of_this, same = of_target(target, own)
        right &= same
        found = of_this | found
    if options.record:
        if absent := [level for level in RECORDED_LEVELS if level not in found]:
            parser.error(f"cannot record without {', '.join(absent)}")
        RECORD.write_text(
            "\n".join(line for level in RECORDED_LEVELS for line in found[level]) + "\n", encoding="utf-8"
        )
    return int(not right)


if __name__ == "__main__":
    sys.exit(main())
