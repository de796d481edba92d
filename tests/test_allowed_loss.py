"""An allowed loss in what is seen: --max-flip, --max-lpips."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.finetune.quality import hold_apart
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.door import Allowed, allowed_loss
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.render.metrics import evaluate, flip, lpips, psnr
from svrgs_addon.render.metrics.allowed_loss import loss_notes, missed_loss, refuse_loss
from svrgs_addon.render.metrics.evaluate import BLOCK, block, quality_of_view
from svrgs_addon.system.errors import SceneError
from svrgs_bench.scenes import orbit_camera

STEPS = ("--iterations", 60, "--recovery", 60)


@pytest.fixture
def no_weights(monkeypatch):
    monkeypatch.setenv(lpips.VARIABLE, "")


@pytest.mark.parametrize(
    "asked, refused",
    [
        ({"max_drop": 1.0, "max_flip": 0.1}, "--max-drop and --max-flip are both given"),
        ({"target": 0.5, "max_flip": 0.1}, "--target and --max-flip are both given"),
        ({"target_count": 9, "max_lpips": 0.1}, "--target-count and --max-lpips are both given"),
        ({"max_lpips": 0.1, "lpips_weights": "w.npz"}, "leave --lpips-weights out"),
        ({"max_lpips": 0.1}, "--max-lpips: no LPIPS weights"),
    ],
)
def test_one_size_is_asked_for(no_weights, asked, refused):
    with pytest.raises(SceneError, match=refused):
        allowed_loss(PruneOptions(**asked))


def test_what_is_asked_for():
    assert allowed_loss(PruneOptions(max_flip=0.1)) == Allowed(0.1, "flip")
    assert allowed_loss(PruneOptions(max_drop=0.5)) == Allowed(0.5, "psnr")
    assert not allowed_loss(PruneOptions(target=0.5)).loss


def test_a_method_that_learns_masks_does_not_take_lpips(tiny, svrgs, monkeypatch, tmp_path):
    monkeypatch.setattr("svrgs_addon.prune.door.weights_file", lambda: tiny.splat)  # any file
    words = ("--data", tiny.folder, "--method", "maskgs", "--max-lpips", 0.1, "--out", tmp_path / "o.ply")
    assert "'maskgs' cannot take --max-lpips" in svrgs("prune", tiny.splat, *words).err


def test_quality_is_higher_where_the_picture_is_nearer():
    rng, camera = np.random.default_rng(0), orbit_camera(40, 30)
    photo = rng.random((30, 40, 3)).astype(np.float32)
    near, far = (np.clip(photo + step, 0, 1).astype(np.float32) for step in (0.02, 0.1))
    for measure, of in (("psnr", psnr), ("flip", lambda a, b: -flip(a, b))):
        qualities = [quality_of_view(picture, photo, camera, measure, 0.0, 0) for picture in (near, far)]
        assert qualities == pytest.approx([of(near, photo), of(far, photo)], rel=1e-6)
        assert qualities[0] > qualities[1]


def test_flip_counts_pixels_that_count():
    camera = orbit_camera(40, 30).masked(np.arange(1_200).reshape(30, 40) % 40 < 20)
    photo = np.zeros((30, 40, 3), np.float32)
    other = photo.copy()
    other[:, 25:] = 1
    assert quality_of_view(other, photo, camera, "flip", 0.0, 0) > -0.2
    assert quality_of_view(other, photo, orbit_camera(40, 30), "flip", 0.0, 0) < -0.3


def test_lpips_of_a_block_counts_the_pixels_of_the_block(monkeypatch):
    monkeypatch.setattr("svrgs_addon.render.metrics.evaluate.default_lpips", lambda: lambda a, b: 0.2)
    valid = np.zeros((300, 400), bool)
    valid[: BLOCK // 2, :BLOCK] = True  # half of the block of the first view
    camera, picture = orbit_camera(400, 300).masked(valid), np.zeros((300, 400, 3), np.float32)
    assert quality_of_view(picture, picture, camera, "lpips", 0.0, 0) == pytest.approx(-0.4)
    valid[:] = False
    assert quality_of_view(picture, picture, camera.masked(valid), "lpips", 0.0, 0) == 0


def test_blocks_are_all_over_the_picture():
    picture = np.moveaxis(np.mgrid[:500, :700], 0, -1)
    corners = [block(picture, number)[0, 0] for number in range(8)]
    assert all(block(picture, number).shape == (BLOCK, BLOCK, 2) for number in range(8))
    assert len({tuple(corner) for corner in corners}) == 8
    assert (np.ptp(corners, axis=0) > 0.6 * (np.array([500, 700]) - BLOCK)).all()
    small = np.zeros((50, 700, 3))
    assert block(small, 3).shape == (50, BLOCK, 3)


@pytest.mark.parametrize("count, decide", [(8, 2), (24, 3), (200, 16)])
def test_views_that_decide_neither_train_nor_measure(data, count, decide):
    found = hold_apart(replace(data, train_indices=list(range(100, 100 + count))), "flip")
    assert len(found.deciding_indices) == decide and found.test_indices == data.test_indices
    assert len(found.train_indices) == count - decide
    assert not set(found.deciding_indices) & set(found.train_indices)


def test_with_very_few_training_views_half_of_the_test_views_decide(data):
    found = hold_apart(replace(data, train_indices=list(range(100, 107))), "flip")
    assert len(found.train_indices) == 7 and not set(found.deciding_indices) & set(found.test_indices)
    assert set(found.deciding_indices) < set(data.test_indices)


def test_flip_is_held_on_photographs(tiny, svrgs, tmp_path):
    results = [
        svrgs(
            "prune", tiny.splat, "--data", tiny.folder, "--holdout", 2, "--max-flip", allowed, *STEPS,
            "--out", tmp_path / "o.ply", "--json",
        ).json
        for allowed in (0.01, 0.1)
    ]  # fmt: skip
    assert results[1]["count"] < results[0]["count"] < results[0]["before"]["count"]
    for result, allowed in zip(results, (0.01, 0.1), strict=True):
        assert result["drop"] == pytest.approx(result["flip"] - result["before"]["flip"], abs=1e-6)
        assert result["drop"] < 2 * allowed or any(
            "FLIP that were allowed" in note for note in result["notes"]
        )


@pytest.mark.parametrize("way", [("--quick",), STEPS])
def test_without_photographs_it_is_what_differs_from_the_original(tiny, svrgs, small_rig, tmp_path, way):
    splat = shutil.copy2(tiny.splat, tmp_path)  # away from its photographs
    words = ("prune", splat, "--max-flip", 0.05, *way, "--out", tmp_path / "o.ply", "--json")
    words += () if "--quick" in way else ("--method", "removal")
    result = svrgs(*words).json
    assert result["drop"] == result["flip"] > 0
    assert result["flip"] < 0.06 or any("FLIP that were allowed" in note for note in result["notes"])
    assert result["count"] < result["before"]["count"]


@pytest.mark.slow
def test_lpips_is_held_by_the_fetched_weights(tiny, svrgs, monkeypatch, tmp_path):
    """A network that tells how bright the difference is."""
    monkeypatch.setattr("svrgs_addon.prune.door.weights_file", lambda: tiny.splat)
    network = lambda a, b: float(np.abs(a - b).mean())
    monkeypatch.setattr("svrgs_addon.render.metrics.evaluate.default_lpips", lambda: network)
    monkeypatch.setattr("svrgs_addon.prune.plans.load_lpips", lambda *_: (network, ""))
    words = ("--data", tiny.folder, "--holdout", 2, *STEPS, "--out", tmp_path / "o.ply", "--json")
    strict, loose = (
        svrgs("prune", tiny.splat, "--max-lpips", allowed, *words).json for allowed in (0.002, 0.05)
    )
    assert loose["count"] < strict["count"]
    assert strict["drop"] == pytest.approx(strict["lpips"] - strict["before"]["lpips"], abs=1e-6)


def test_a_format_that_loses_all_that_is_allowed_is_refused():
    refuse_loss(Path("a.spz"), 0.49, 0.5)
    with pytest.raises(SceneError, match="a.spz: the format alone loses 0.5 dB, not less than --max-drop"):
        refuse_loss(Path("a.spz"), 0.5, 0.5)


def test_a_loss_a_little_above_what_is_allowed_is_not_told():
    assert missed_loss(0.59, 0.5) == missed_loss(None, 0.5) == []
    assert "the result loses 0.61 dB, more than the 0.5 dB that were allowed" in missed_loss(0.61, 0.5)[0]


def test_a_format_is_blamed_from_half_of_the_error_on():
    assert loss_notes(30.0, 27.0) == []
    assert "30.0 dB before it was written, 26.9 dB after" in loss_notes(30.0, 26.9)[0]
    assert "all that is lost, the format of the output loses" in loss_notes(100.0, 40.0)[0]


def test_lpips_is_measured_in_a_few_views_alone(data, tiny, monkeypatch):
    asked = []
    monkeypatch.setattr(evaluate, "default_lpips", lambda: lambda *_: asked.append(1) or 0.25)
    options = evaluate.render_options(tiny.truth)
    views = range(len(data.cameras))
    assert evaluate.mean_quality(tiny.truth, data, views, Rasterizer(), options, measure="lpips") == -0.25
    assert len(asked) == evaluate.BLOCKS < len(views)
