"""The rule that the default holds in the published rows of docs/results/rows.jsonl (study `schedules` of
benchmarks/methods.py)."""

import itertools
import json
from collections import defaultdict
from pathlib import Path
from statistics import fmean

import pytest

ROWS = Path(__file__).resolve().parents[1] / "docs" / "results" / "rows.jsonl"
SHARES, SCHEDULES, SCENES = ("0.25", "0.1", "0.05", "0.02"), (0.1, 0.4, 1.0), 3
DEFAULT, RIVALS = "removal", ("maskgs", "gns")
MOST = 0.1  # dB by which the default, or a longer schedule, may be behind
AHEAD = 0.2  # dB by which the default is at least ahead on scenes trained to their end


@pytest.fixture(scope="module")
def psnr() -> dict[tuple, dict[int, float]]:
    """PSNR of each seed by (case, share, schedule, method). A case is a scene and the size of its
    photographs. Cases that lack a run are left out."""
    found: dict[tuple, dict] = defaultdict(lambda: defaultdict(dict))
    for row in map(json.loads, ROWS.read_text().splitlines()):
        if row["study"] == "schedules" and "error" not in row:
            method, share = row["run"].split()
            found[row["scene"], row["shrink"], row["trained"], row["start"]][share, row["schedule"], method][
                row["seed"]
            ] = row["psnr"]
    runs = set(itertools.product(SHARES, SCHEDULES, (DEFAULT, *RIVALS)))
    return {
        (case, *run): seeds
        for case, those in found.items()
        if runs <= set(those)
        for run, seeds in those.items()
    }


def behind(ours: dict[int, float], other: dict[int, float]) -> float:
    """PSNR of the other run minus ours, mean of the seeds that both have."""
    return fmean(other[seed] - ours[seed] for seed in ours.keys() & other.keys())


def test_rows_cover_enough_scenes(psnr):
    assert len({case for case, *_ in psnr}) >= SCENES


def test_default_is_nowhere_behind_its_nearest_rivals(psnr):
    ours = {place: seeds for place, seeds in psnr.items() if place[-1] == DEFAULT}
    gaps = {
        (*place[:-1], rival): behind(seeds, psnr[*place[:-1], rival])
        for place, seeds in ours.items()
        for rival in RIVALS
    }
    assert not {place: gap for place, gap in gaps.items() if gap > MOST}


def test_longer_schedule_is_nowhere_worse(psnr):
    worse = {}
    for (case, share, schedule, method), seeds in psnr.items():
        for longer in (other for other in SCHEDULES if method == DEFAULT and other > schedule):
            worse[case[0], share, schedule, longer] = behind(psnr[case, share, longer, method], seeds)
    assert not {place: loss for place, loss in worse.items() if loss > MOST}


def test_default_is_ahead_on_scenes_trained_to_their_end_with_three_seeds():
    """Study `pareto`: of every method of other papers by AHEAD, at each share, and above as many further
    steps without pruning."""
    found: dict[tuple, dict] = defaultdict(lambda: defaultdict(dict))
    for row in map(json.loads, ROWS.read_text().splitlines()):
        if (
            row["study"] == "pareto"
            and "error" not in row
            and (row["trained"], row["start"]) == (1.0, "3DGS")
        ):
            found[row["scene"], row["shrink"]][row["run"]][row["seed"]] = row["psnr"]
    cases = [runs for runs in found.values() if len(runs[f"{DEFAULT} 0.5"]) >= 3]
    assert len(cases) >= 2
    for runs in cases:
        for share in ("0.5", "0.25", "0.1", "0.05"):
            ours = runs[f"{DEFAULT} {share}"]
            rivals = {
                run: other
                for run, other in runs.items()
                if run.endswith(f" {share}") and not run.startswith((DEFAULT, "saliency"))
            }
            assert len(rivals) > 10 and not {
                run for run, other in rivals.items() if behind(ours, other) > -AHEAD
            }
            assert behind(ours, runs["3dgs"]) < 0
