"""The names of the levels of detail that a job writes beside its output."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from ..files.registry import split_name


def level_files(out: Path, shares: Iterable[float]) -> dict[float, Path]:
    """The file of each level of detail by its share of the result: OUT_50.ply for 0.5."""
    name, suffix = split_name(out)
    return {share: out.with_name(f"{name}_{100 * share:g}{suffix}") for share in shares}
