"""How sure the rank of a Gaussian is (prune/selection/measure.py), and that every processor keeps the same
Gaussians."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.finetune.saliency import removal_errors
from svrgs_addon.finetune.scores import top
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native import library
from svrgs_addon.native.library import supported_levels
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.selection.measure import NAMES, SPREADS, measured, summary
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system.errors import SceneError
from svrgs_addon.views.camera_files import load_cameras
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_bench.scenes import orbit_camera, room

CAMERAS = [replace(orbit_camera(96, 64, turn), name=f"{k}") for k, turn in enumerate((0, 72, 144, 216, 288))]


def cameras_file(folder: Path) -> Path:
    write_cameras_json(folder / "cameras.json", CAMERAS)
    return folder / "cameras.json"


def ranks(errors: np.ndarray) -> np.ndarray:
    """The share of the Gaussians with a lower error, one Gaussian at a time."""
    return np.array([(errors < error).mean() for error in errors])


def test_attributes_are_those_of_looks_at_single_views():
    scene = room(400)
    looks = [ViewedScene.of(scene, [camera]) for camera in CAMERAS]
    views = np.array([removal_errors(look) for look in looks])
    found = measured(scene, CAMERAS)
    assert tuple(found) == NAMES and all(values.shape == (scene.count,) for values in found.values())
    errors, unseen = views.sum(axis=0), ~views.any(axis=0)
    assert 0 < unseen.sum() < scene.count
    np.testing.assert_allclose(found["removal_error"], errors, rtol=1e-6)
    np.testing.assert_allclose(found["removal_rank"], ranks(errors), atol=1e-6)
    np.testing.assert_array_equal(found["deciding_view"], np.where(unseen, -1, views.argmax(axis=0)))
    share = views / np.maximum(errors, 1e-300)
    expected = np.where(unseen, 0, 1 / np.maximum((share**2).sum(axis=0), 1e-300))
    np.testing.assert_allclose(found["deciding_views"], expected, rtol=1e-5)
    moved = np.abs(ranks(views[::2].sum(axis=0)) - ranks(views[1::2].sum(axis=0)))
    np.testing.assert_allclose(found["rank_spread_views"], moved, atol=1e-6)
    full = sum(removal_errors(look, reduction=1) for look in looks)
    np.testing.assert_allclose(found["rank_spread_size"], np.abs(ranks(errors) - ranks(full)), atol=1e-6)
    assert found["rank_spread_precision"].max() <= 2 / scene.count


def test_one_gaussian_that_one_view_sees_is_decided_by_it():
    scene = room(400)
    found, alone = measured(scene, CAMERAS, all_looks=False), measured(scene, [CAMERAS[0]] * 2)
    assert tuple(found) == NAMES[:-2] and found["rank_spread_views"].any()
    seen = alone["deciding_view"] >= 0
    np.testing.assert_allclose(alone["deciding_views"][seen], 2, rtol=1e-6)  # the same view twice
    assert not alone["rank_spread_views"].any() and (alone["deciding_view"][seen] == 0).all()
    with pytest.raises(SceneError, match="at least two views"):
        measured(scene, CAMERAS[:1])


def test_the_summary_says_what_the_attributes_hold():
    n = 100
    errors = np.r_[np.full(90, 1.0), np.full(10, 91.0)].astype(np.float32)
    attributes = {
        "removal_error": errors,
        "deciding_view": np.where(np.arange(n) < 40, -1, 0).astype(np.int32),
        "deciding_views": np.where(np.arange(n) < 40, 0, 7).astype(np.float32),
        "rank_spread_views": np.where(np.arange(n) < 80, 0, 0.5).astype(np.float32),
    }
    found = summary(attributes)
    assert found == {"share_of_tenth": 0.91, "deciding_views": 7.0, "rank_spread_views": 0.5}


@pytest.mark.parametrize("reduction", [1, 2])
def test_every_level_and_any_number_of_threads_keep_the_same_gaussians(reduction):
    scene = room(6_000)
    kept = {}
    for level in supported_levels():
        rasterizer = Rasterizer(level)
        arrays = {name: np.asarray(getattr(scene, name), rasterizer.dtype) for name in PARAMETERS}
        own = SimpleNamespace(**arrays, count=scene.count)
        viewed = ViewedScene(own, CAMERAS, rasterizer, render_options(scene))
        for threads in (1, 3) if level == supported_levels()[-1] else (2,):
            library.set_threads(threads)
            errors = removal_errors(viewed, reduction=reduction)
            kept[level, threads] = [
                top(errors, round(share * scene.count)) for share in (0.5, 0.25, 0.1, 0.05)
            ]
    library.set_threads(0)
    first, *others = kept.values()
    assert len(others) >= 3
    for masks in others:
        for mask, expected in zip(masks, first, strict=True):
            np.testing.assert_array_equal(mask, expected)


def test_the_command_writes_the_attributes_and_says_what_they_hold(svrgs, tmp_path):
    scene = room(300)
    write_ply(tmp_path / "s.ply", scene)
    cameras = cameras_file(tmp_path)
    done = svrgs("select", tmp_path / "s.ply", "--cameras", cameras, "--measure", "--out", tmp_path / "m.ply")
    assert done.status == 0 and "of the removal error" in done.out and "300 of 300" in done.out
    written = read_ply(tmp_path / "m.ply")
    expected = measured(scene, load_cameras(cameras))
    for name in NAMES:
        np.testing.assert_array_equal(written.attributes[name], expected[name])
    np.testing.assert_array_equal(written.sh, scene.sh)
    again = svrgs("select", tmp_path / "m.ply", "--cameras", cameras, "--measure", "--opacity", "0.5,",
                  "--out", tmp_path / "o.ply", "--json")  # fmt: skip
    result = json.loads(again.out)
    chosen = 1 / (1 + np.exp(-scene.opacity_logits.astype(float))) >= 0.5
    assert result["selected"] == chosen.sum() and set(SPREADS) < set(result["measured"])
    np.testing.assert_array_equal(
        read_ply(tmp_path / "o.ply").attributes["removal_rank"], expected["removal_rank"][chosen]
    )


def test_the_command_refuses_what_cannot_be_written_or_measured(svrgs, tmp_path):
    write_ply(tmp_path / "s.ply", room(50))
    cameras = cameras_file(tmp_path)
    other = svrgs(
        "select", tmp_path / "s.ply", "--cameras", cameras, "--measure", "--out", tmp_path / "m.spz"
    )
    assert other.status != 0 and "only a PLY holds" in other.err and not (tmp_path / "m.spz").exists()
    turned = svrgs("select", tmp_path / "s.ply", "--cameras", cameras, "--measure", "--invert")
    assert turned.status == 2 and "--invert needs a criterion" in turned.err
    write_ply(tmp_path / "bad.ply", replace(room(50), means=np.full((50, 3), np.nan, np.float32)))
    bad = svrgs("select", tmp_path / "bad.ply", "--cameras", cameras, "--measure", "--force")
    assert bad.status == 2 and "none can be measured" in bad.err
    none = svrgs("select", tmp_path / "s.ply", "--measure")
    assert none.status != 0 and "--data or --cameras" in none.err
