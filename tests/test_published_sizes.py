"""What docs/results.md says of SH degrees in files of one size is what the rows say."""

from __future__ import annotations

import numpy as np
import pytest

from published_rows import rows_of, said

SEEDS = {"0.2": (0, 1, 2), "0.6": (0,)}  # by the size in MB
RUNS = {(row["scene"], row["run"], row["seed"]): row for row in rows_of(study="sizes")}
SCENES = sorted({scene for scene, *_ in RUNS})
BETTER = [scene != "snowmiku" for scene in SCENES]  # in PSNR, with degree 2 in 0.2 MB


def changes(degree: int, size: str, name: str) -> np.ndarray:
    """From degree 3, (scenes, seeds)."""
    value = lambda scene, which, seed: RUNS[scene, f"SH {which}, {size} MB", seed][name]
    return np.array([[value(s, degree, k) - value(s, 3, k) for k in SEEDS[size]] for s in SCENES])


def ends(values: np.ndarray, digits: int) -> list[float]:
    return [round(values.min(), digits), round(values.max(), digits)]


def megabytes(size: str, bare: bool = False) -> np.ndarray:
    """bare: of files without bands."""
    those = [row for (_, run, _), row in RUNS.items() if run.startswith("SH 0") == bare]
    return np.array([row["bytes"] / 1e6 for row in those if row["run"].endswith(f"{size} MB")])


@pytest.mark.parametrize(
    "size, sentence",
    [
        ("0.2", "which is # to # % of the Gaussians with all bands"),
        ("0.6", "of at most 0.6 MB, # to # %, one seed"),
    ],
)
def test_so_many_gaussians_stay(size, sentence):
    those = [row for (_, run, _), row in RUNS.items() if run == f"SH 3, {size} MB"]
    kept = np.array([100 * row["count"] / row["before"]["count"] for row in those])
    assert said("results.md", sentence) == ends(kept, 0) and len(SCENES) == 6


def test_so_large_are_the_files():
    found = [*ends(megabytes("0.2"), 3), *ends(megabytes("0.6"), 3), *ends(megabytes("0.2", bare=True), 3)]
    assert said("results.md", "The files have # to # and # to # MB, those without bands # to #") == found


def test_degree_2_in_small_files():
    less, more = -changes(2, "0.2", "lpips"), changes(2, "0.2", "psnr")
    assert less.min() > 0 and more[BETTER].min() > 0
    found = [*ends(less.mean(axis=1), 3), *ends(more.mean(axis=1)[BETTER], 2)]
    each = "with every seed, in the mean by # to #"
    sentence = f"{each.replace('seed,', 'seed**,')}, and more PSNR in five, {each}"
    assert said("results.md", sentence) == found
    (snowmiku,) = more.mean(axis=1)[~np.array(BETTER)]
    assert said("results.md", "has # dB less.") == [round(-snowmiku, 2)]


def test_degree_1_in_small_files():
    less, more = -changes(1, "0.2", "lpips").mean(axis=1), changes(1, "0.2", "psnr").mean(axis=1)
    sentence = "Degree 1 has # to # LPIPS less in all six, and # to # dB more in four"
    assert said("results.md", sentence) == [*ends(less, 3), *ends(more[more > 0], 2)]
    assert (more > 0).sum() == 4


def test_degree_2_in_larger_files():
    less, more = -changes(2, "0.6", "lpips"), changes(2, "0.6", "psnr")
    sentence = "degree 2 has # to # LPIPS less in all six, and between # dB less and # dB more"
    assert said("results.md", sentence) == [*ends(less, 3), round(-more.min(), 2), round(more.max(), 2)]
