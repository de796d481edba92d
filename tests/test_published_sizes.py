"""What docs/results.md says of SH degrees in files of one size is what the rows say."""

from __future__ import annotations

import numpy as np

from published_rows import rows_of, said


def test_sentences_on_files_of_one_size_are_those_of_the_rows():
    runs = {(row["scene"], row["run"], row["seed"]): row for row in rows_of(study="sizes")}
    scenes, seeds = sorted({scene for scene, *_ in runs}), {"0.2": (0, 1, 2), "0.6": (0,)}
    assert len(scenes) == 6

    def changes(degree: int, size: str, name: str) -> np.ndarray:
        """From degree 3, (scenes, seeds)."""
        value = lambda scene, which, seed: runs[scene, f"SH {which}, {size} MB", seed][name]
        return np.array([[value(s, degree, k) - value(s, 3, k) for k in seeds[size]] for s in scenes])

    ends = lambda values, digits: [round(values.min(), digits), round(values.max(), digits)]
    megabytes = lambda size, bare: np.array([
        row["bytes"] / 1e6 for (_, run, _), row in runs.items()
        if run.endswith(f"{size} MB") and run.startswith("SH 0") == bare
    ])  # fmt: skip
    found = [
        *ends(megabytes("0.2", False), 3),
        *ends(megabytes("0.6", False), 3),
        *ends(megabytes("0.2", True), 3),
    ]
    assert said("results.md", "The files have # to # and # to # MB, those without bands # to #") == found
    kept = lambda size: np.array([
        100 * row["count"] / row["before"]["count"] for (_, run, _), row in runs.items() if run == f"SH 3, {size} MB"
    ])  # fmt: skip
    assert said("results.md", "which is # to # % of the Gaussians with all bands") == ends(kept("0.2"), 0)
    assert said("results.md", "of at most 0.6 MB, # to # %, one seed") == ends(kept("0.6"), 0)
    less, more = -changes(2, "0.2", "lpips"), changes(2, "0.2", "psnr")
    better = [scene != "snowmiku" for scene in scenes]
    assert less.min() > 0 and more[better].min() > 0
    sentence = "with every seed**, in the mean by # to #, and more PSNR in five, with every seed, in the mean by # to #"
    assert said("results.md", sentence) == [*ends(less.mean(axis=1), 3), *ends(more.mean(axis=1)[better], 2)]
    (snowmiku,) = more.mean(axis=1)[~np.array(better)]
    assert said("results.md", "has # dB less.") == [round(-snowmiku, 2)]
    less, more = -changes(1, "0.2", "lpips").mean(axis=1), changes(1, "0.2", "psnr").mean(axis=1)
    assert (more > 0).sum() == 4
    sentence = "Degree 1 has # to # LPIPS less in all six, and # to # dB more in four"
    assert said("results.md", sentence) == [*ends(less, 3), *ends(more[more > 0], 2)]
    less, more = -changes(2, "0.6", "lpips"), changes(2, "0.6", "psnr")
    sentence = "degree 2 has # to # LPIPS less in all six, and between # dB less and # dB more"
    assert less.min() > 0
    assert said("results.md", sentence) == [*ends(less, 3), round(-more.min(), 2), round(more.max(), 2)]
