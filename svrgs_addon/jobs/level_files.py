"""The names of the levels of detail that a job writes beside its output."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path


def level_files(out: Path, shares: Iterable[float]) -> dict[float, Path]:
    """The file of each level of detail by its share of the result: OUT_50.ply for 0.5."""
    return {share: out.with_stem(f"{out.stem}_{100 * share:g}") for share in shares}
