"""The rows of docs/results, and the figures of the sentences on them."""

from __future__ import annotations

import json
import re
from collections import defaultdict
from collections.abc import Collection
from pathlib import Path
from statistics import fmean

ROWS = Path(__file__).resolve().parents[1] / "docs/results/rows.jsonl"
DOCS = ROWS.parents[1]


def rows_of(**case) -> list[dict]:
    """The rows that have these values."""
    return [row for row in map(json.loads, ROWS.read_text().splitlines()) if case.items() <= row.items()]


def by_run(**case) -> dict[str, dict]:
    """The one row of each run."""
    found = rows_of(**case)
    assert len(found) == len({row["run"] for row in found})
    return {row["run"]: row for row in found}


def by_seed(**case) -> dict[tuple[str, str], dict[int, dict]]:
    """The rows by scene and run, and by seed."""
    found: dict[tuple[str, str], dict[int, dict]] = defaultdict(dict)
    for row in rows_of(**case):
        found[row["scene"], row["run"]][row["seed"]] = row
    return found


def ends(values: Collection[float], digits: int = 1) -> list[float]:
    """The least and the largest, rounded."""
    return [round(end, digits) for end in (min(values), max(values))]


def said(page: str, sentence: str) -> list[float]:
    """The figures of a sentence of a page, in which # stands for each."""
    pattern = re.escape(sentence).replace(r"\ ", r"\s+").replace(r"\#", r"(\d[\d ]*(?:\.\d+)?)")
    (found,) = re.finditer(pattern, (DOCS / page).read_text())
    return [float(figure.replace(" ", "")) for figure in found.groups()]


def means_by_run(**case) -> dict[str, tuple[float, float]]:
    """Mean PSNR and LPIPS of the three seeds of each run."""
    found: dict[str, list] = defaultdict(list)
    for row in rows_of(**case):
        found[row["run"]].append((row["psnr"], row["lpips"]))
    assert all(len(some) == 3 for some in found.values())
    return {run: tuple(map(fmean, zip(*some, strict=True))) for run, some in found.items()}


def gains_by_seed(one: str, other: str, **case) -> list[tuple[float, float]]:
    """How far a run is ahead of another one with each seed: in PSNR, and in LPIPS, where less is better."""
    runs = [{row["seed"]: row for row in rows_of(**case, run=run)} for run in (one, other)]
    assert runs[0].keys() == runs[1].keys() and len(runs[0]) == 3
    pairs = [(runs[0][seed], runs[1][seed]) for seed in runs[0]]
    return [(ours["psnr"] - other["psnr"], other["lpips"] - ours["lpips"]) for ours, other in pairs]
