"""Distractors: what stands in one photograph alone is found, and does not count there."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files.images import read_pixels, write_image
from svrgs_addon.files.registry import write_scene
from svrgs_addon.prune.distractors import distractors_of, without_distractors
from svrgs_addon.views.dataset import load_dataset
from svrgs_addon.views.valid_pixels import MaskOptions

TRAINED = [number for number in range(12) if number % 8]
TROUBLED = [number for number in range(12) if number % 2]
STEPS = ("--iterations", 60, "--recovery", 60, "--target", 0.8)


def place(number: int) -> tuple[slice, slice]:
    """Where something stands in a photograph."""
    return slice(8 + 2 * number, 24 + 2 * number), slice(3 * number, 3 * number + 16)


@pytest.fixture
def crowded(tiny, tmp_path) -> Path:
    """The tiny dataset, in every other of whose photographs something stands."""
    folder, rng = tmp_path / "crowded", np.random.default_rng(0)
    shutil.copytree(tiny.folder, folder)
    for number in TROUBLED:
        photo = folder / "images" / f"{number:02}.png"
        pixels = read_pixels(photo)
        pixels[place(number)] = rng.integers(0, 256, 3) * rng.uniform(0.9, 1, (16, 16, 1))
        write_image(photo, pixels)
    return folder


@pytest.fixture
def splat(tiny, tmp_path) -> Path:
    """One that shows the photographs without distractors."""
    write_scene(tmp_path / "truth.ply", tiny.truth)
    return tmp_path / "truth.ply"


def test_they_are_found_where_they_stand_and_nowhere_else(tiny, crowded):
    found = distractors_of(tiny.truth, load_dataset(crowded))
    assert sorted(found) == TRAINED
    for number, marked in found.items():
        truth = np.zeros_like(marked)
        if number in TROUBLED:
            truth[place(number)] = True
            assert marked[truth].mean() > 0.7
        assert marked[~truth].mean() < 0.06


def test_photographs_without_any_stay_as_they_are(tiny):
    data = load_dataset(tiny.folder)
    same, sentence = without_distractors(tiny.truth, data)
    assert [a is b for a, b in zip(same.cameras, data.cameras, strict=True)] == [True] * 12
    assert sentence.startswith("distractors cover 0.0% of the photographs")


def test_masks_that_were_given_stay(tiny, crowded):
    data = load_dataset(crowded)
    valid = np.ones((48, 64), np.uint8)
    valid[:, :5] = 0
    masked = replace(data, cameras=[camera.masked(valid) for camera in data.cameras])
    found, _ = without_distractors(tiny.truth, masked)
    for number in TROUBLED:
        kept = found.cameras[number].valid
        assert not kept[:, :5].any() and kept[place(number)].mean() < 0.4 and kept.mean() > 0.7
        assert not found.image(number)[kept == 0].any()
    # held-out views are measured as they are
    np.testing.assert_array_equal(found.cameras[8].valid, valid)


def test_a_job_that_masks_them_is_nearer_to_the_truth(tiny, splat, crowded, tmp_path, svrgs):
    figures = []
    for words in ([], ["--mask-distractors"]):
        out = tmp_path / f"{len(words)}.ply"
        found = svrgs("prune", splat, "--data", crowded, *STEPS, "--out", out, *words, "--json").json
        assert any(note.startswith("distractors cover") for note in found["notes"]) == bool(words)
        figures.append(svrgs("eval", out, "--data", tiny.folder, "--json").json["psnr"])
    assert figures[1] > figures[0] + 1
    written = tmp_path / "1.ply_distractor_masks"
    assert found["masks"] == str(written) and not (tmp_path / "0.ply_distractor_masks").exists()
    again = load_dataset(crowded, masks=MaskOptions(written))
    for number in TRAINED:
        valid = again.cameras[number].valid
        assert valid.all() == (number not in TROUBLED) and valid.mean() > 0.7
    assert set(found["photographs"]) == {f"{number:02}.png" for number in TRAINED if number in TROUBLED}


@pytest.mark.parametrize("words", [["--quick"], []])
def test_without_photographs_it_is_refused(splat, tmp_path, svrgs, words):
    out = tmp_path / "o.ply"
    found = svrgs("prune", splat, "--target", 0.5, "--mask-distractors", "--out", out, *words)
    assert found.status == 2 and "--mask-distractors" in found.err
