"""python -m tests.fuzz TARGET [--seconds 30] [--seed 0] [--atheris]: inputs tried, accepted, slowest; the
input that breaks a promise.

With --atheris (its package is needed) coverage leads the search; else mutate.py's changes do.
"""

from __future__ import annotations

import argparse
import logging
import random
import sys
import tempfile
import time
from pathlib import Path

from fuzz import NAMES


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.fuzz")
    parser.add_argument("target", choices=NAMES)
    parser.add_argument("--seconds", type=float, default=30)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--atheris", action="store_true")
    options = parser.parse_args()
    logging.disable(logging.WARNING)  # what readers say of odd files
    with tempfile.TemporaryDirectory() as folder:
        run = _with_atheris if options.atheris else _with_mutations
        return run(options, Path(folder))


def _with_mutations(options: argparse.Namespace, folder: Path) -> int:
    from fuzz.mutate import mutated
    from fuzz.seeds import target

    check, seeds = target(options.target, folder)
    chance, tried, accepted, slowest = random.Random(options.seed), 0, 0, 0.0
    end = time.monotonic() + options.seconds
    while time.monotonic() < end:
        data, started = mutated(chance.choice(seeds), chance), time.process_time()
        try:
            accepted += check(data)
        except Exception:
            broken = Path(f"broken-{options.target}.bin")
            broken.write_bytes(data)
            print(
                f"{options.target}: a promise is broken by {broken.resolve()} ({tried} tried before)",
                file=sys.stderr,
            )
            raise
        tried, slowest = tried + 1, max(slowest, time.process_time() - started)
    print(f"{options.target}: {tried} inputs, {accepted} accepted, slowest {slowest:.3f} s, nothing broken")
    return 0


def _with_atheris(options: argparse.Namespace, folder: Path) -> int:
    import atheris

    with atheris.instrument_imports(include=["svrgs_addon"]):
        from fuzz.seeds import target

    check, seeds = target(options.target, folder)
    corpus = folder / "corpus"
    corpus.mkdir()
    for number, data in enumerate(seeds):
        (corpus / str(number)).write_bytes(data)
    words = [
        sys.argv[0],
        f"-max_total_time={int(options.seconds)}",
        f"-seed={options.seed + 1}",
        "-max_len=65536",
        "-print_final_stats=1",
    ]
    words += [f"-artifact_prefix=broken-{options.target}-", str(corpus)]
    atheris.Setup(words, lambda data: check(bytes(data)) and None)
    atheris.Fuzz()
    return 0


if __name__ == "__main__":
    sys.exit(main())
