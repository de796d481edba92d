"""A splat and photographs that do not belong together are noticed."""

from __future__ import annotations

import json
import logging

import numpy as np
import pytest

from svrgs_addon.cli.main import main
from svrgs_addon.files.registry import load_scene
from svrgs_addon.jobs.photo_sample import read_in_child
from svrgs_addon.render.metrics.explained import ENOUGH, explained, fit, mismatch, sample_views
from svrgs_addon.views.dataset import load_dataset
from tiny_dataset import write_tiny


def test_the_share_is_that_of_the_variance():
    photo = np.random.default_rng(0).random((8, 9, 3)).astype(np.float32)
    assert explained(photo, photo) == 1
    flat = np.broadcast_to(photo.mean(axis=(0, 1)), photo.shape)
    assert explained(flat, photo) == pytest.approx(0, abs=1e-6)
    halfway = (flat + photo) / 2
    assert explained(halfway, photo) == pytest.approx(0.75, abs=1e-6)
    assert explained(1 - photo, photo) < 0
    assert explained(np.zeros_like(photo), np.full_like(photo, 0.3)) == 1  # nothing to explain


def test_own_photographs_are_explained_and_those_of_another_capture_are_not(tiny, tmp_path):
    other = write_tiny(tmp_path / "other", seed=7)
    scene, dataset = load_scene(tiny.splat), load_dataset(tiny.folder)
    own, foreign = (fit(scene, sample_views(one)) for one in (dataset, load_dataset(other.folder)))
    assert own["explained"] > 0.8 and mismatch(own) == ""
    assert foreign["explained"] < ENOUGH and "may belong to another capture" in mismatch(foreign)


def test_the_sentence_never_names_a_share_below_nothing():
    assert "explains only 0% of" in mismatch({"explained": -3.2, "psnr": 7.1})
    assert "7.1 dB" in mismatch({"explained": -3.2, "psnr": 7.1})
    assert mismatch({"explained": ENOUGH, "psnr": 7.1}) == ""


def test_the_child_process_gives_the_same_views(tiny):
    for (camera, photo), (other_camera, other) in zip(
        sample_views(load_dataset(tiny.folder)), read_in_child(str(tiny.folder), ""), strict=True
    ):
        assert camera.key == other_camera.key
        np.testing.assert_array_equal(photo, other)


def test_pruning_with_the_cameras_of_another_capture_says_so(tiny, tmp_path, caplog, capsys):
    other = write_tiny(tmp_path / "other", seed=7)
    words = f"prune {tiny.splat} --target 0.5 --iterations 5 --recovery 0 --quiet --json".split()
    for number, (folder, warned) in enumerate(((tiny.folder, False), (other.folder, True))):
        more = ["--force"] if warned else []
        with caplog.at_level(logging.WARNING):
            assert main([*words, *more, "--data", str(folder), "--out", str(tmp_path / f"{number}.ply")]) == 0
        notes = json.loads(capsys.readouterr().out.splitlines()[-1])["notes"]
        assert any("another capture" in note for note in notes) == warned
        assert ("another capture" in caplog.text) == warned
        caplog.clear()
