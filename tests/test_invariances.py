"""Units of length are arbitrary: COLMAP has no scale. A capture in other units gives the same outcome."""

from __future__ import annotations

import shutil
from dataclasses import replace

import numpy as np
import pytest

import scenes
import tiny_dataset
from colmap_model import write_colmap
from svrgs_addon.cli.arguments import parser
from svrgs_addon.cli.view_scenes import source_of
from svrgs_addon.files.images import read_pixels
from svrgs_addon.files.registry import load_scene, read_scene, write_scene
from svrgs_addon.jobs.photo_sample import read_in_child
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune import job_views
from svrgs_addon.render.metrics import psnr
from svrgs_addon.render.metrics.explained import sample_views
from svrgs_addon.scene.affine import scaled
from svrgs_addon.scene.camera import in_their_unit
from svrgs_addon.system import memory
from svrgs_addon.viewer.source import Source
from svrgs_addon.views.cameras_json import load_cameras_json, write_cameras_json
from svrgs_addon.views.dataset import load_dataset
from svrgs_addon.views.rig.around import cameras_around
from svrgs_addon.views.rig.place import quick_rig

SMALL, LARGE = 0.01, 100.0


@pytest.fixture(scope="module")
def capture(tiny, tmp_path_factory):
    """Gives the folder of the tiny dataset and its splat, all lengths multiplied by a factor."""
    folders = {}

    def of(factor: float):
        if factor not in folders:
            folders[factor] = folder = tmp_path_factory.mktemp("capture")
            cameras = [camera.moved(np.diag([1 / factor] * 3 + [1])) for camera in tiny.cameras]
            shutil.copytree(tiny.folder / "images", folder / "images")
            write_colmap(folder / "sparse" / "0", cameras, factor * tiny.truth.means)
            write_scene(folder / "scene.ply", scaled(read_scene(tiny.splat), factor))
        return folders[factor]

    return of


def likeness(a, b) -> float:
    """PSNR in dB of two scenes in the views of the tiny dataset."""
    rasterizer = Rasterizer()
    pictures = [
        [rasterizer.forward(s, camera)["rgb"].clip(0, 1) for camera in tiny_dataset.views()] for s in (a, b)
    ]
    return float(np.mean([psnr(x, y) for x, y in zip(*pictures, strict=True)]))


WAYS = {
    "photographs": "--data {} --iterations 10 --recovery 20",
    "popspa": "--data {} --method popspa --iterations 60 --recovery 20",
    "own pictures": "--method removal --iterations 10 --recovery 20 --force",
    "merge": "--recovery 20 --force",
    "quick, data": "--quick --data {}",
    "quick": "--quick",
}


@pytest.mark.parametrize("way", WAYS)
@pytest.mark.parametrize("factor", [SMALL, LARGE])
def test_prune_in_other_units(svrgs, small_rig, capture, tmp_path, way, factor):
    outcomes = []
    for k, unit in enumerate((1.0, factor)):
        folder, out = capture(unit), tmp_path / f"{k}.ply"
        svrgs("prune", folder / "scene.ply", WAYS[way].format(folder), "--target 0.4 --out", out, "--json")
        outcomes.append(scaled(load_scene(out), 1 / unit))
    original = scaled(load_scene(capture(1.0) / "scene.ply"), 1.0)
    assert likeness(*outcomes) > 30
    assert abs(likeness(outcomes[0], original) - likeness(outcomes[1], original)) < 1


@pytest.mark.parametrize("more", ["", "--densify mcmc --cap 200"])
@pytest.mark.parametrize("factor", [SMALL, LARGE])
def test_train_in_other_units(svrgs, capture, tmp_path, more, factor):
    outcomes = []
    for k, unit in enumerate((1.0, factor)):
        out = tmp_path / f"{k}.ply"
        svrgs("train --data", capture(unit), "--iterations 60 --recovery 0", more, "--out", out, "--json")
        outcomes.append(scaled(load_scene(out), 1 / unit))
    assert outcomes[0].count == outcomes[1].count and likeness(*outcomes) > 35


def test_measures_in_other_units(svrgs, capture, tmp_path):
    for number, words in enumerate(
        ("eval {0}/scene.ply --data {0}", "compare {0}/scene.ply {0}/scene.ply --data {0}")
    ):
        figures = [
            svrgs(
                words.format(capture(unit)), "--out" if number else "", tmp_path if number else "", "--json"
            ).json
            for unit in (1.0, SMALL)
        ]
        one, other = (found["a"] if number else found for found in figures)
        assert one["psnr"] > 15 and abs(one["psnr"] - other["psnr"]) < 0.01


def test_placed_cameras_keep_their_distance_in_sizes_of_the_scene():
    ball = scenes.ball(500, 3.3)
    for place in (lambda scene: quick_rig(scene, 12).cameras, lambda scene: cameras_around(scene, 12, 64)):
        usual, small = place(ball), place(scaled(ball, SMALL))
        for a, b in zip(usual, small, strict=True):
            np.testing.assert_allclose(b.position / SMALL, a.position, rtol=0.1, atol=0.1)
        assert all(Rasterizer().forward(scaled(ball, SMALL), camera)["rgb"].any() for camera in small)


@pytest.mark.parametrize("factor", [1e-4, 1e4])
def test_blocks_in_other_units(svrgs, small_rig, monkeypatch, capture, tmp_path, factor):
    monkeypatch.setattr(memory, "decimating", lambda *_: 10**15)
    monkeypatch.setattr(job_views, "PLACED_FOR_QUICK", 12)
    outcomes = []
    for k, unit in enumerate((1.0, factor)):
        folder, out = capture(unit), tmp_path / f"{k}.ply"
        words = f"--quick --data {folder} --target 0.4 --json"
        assert svrgs("prune", folder / "scene.ply", words, "--out", out).json["blocks"] == 1
        outcomes.append(scaled(load_scene(out), 1 / unit))
    assert likeness(*outcomes) > 30


def test_a_page_begins_in_front_of_a_small_splat():
    ball = scenes.ball(500, 1.0)
    starts = [Source(("ball",), (scaled(ball, unit),), []).start().position / unit for unit in (1.0, SMALL)]
    np.testing.assert_allclose(*starts, rtol=1e-3)


def test_cameras_of_a_file_know_the_size_of_their_world(capture, tmp_path):
    cameras = [load_dataset(capture(unit), cameras_only=True).cameras for unit in (1.0, SMALL)]
    assert cameras[0][0].unit == 1 and cameras[1][0].unit == pytest.approx(0.0066, abs=1e-4)


def test_a_camera_alone_in_its_file_shows_a_small_splat(svrgs, capture, tmp_path):
    pictures = []
    for factor in (1.0, SMALL):
        folder = capture(factor)
        one = [replace(camera, unit=1.0) for camera in load_dataset(folder, cameras_only=True).cameras[:1]]
        write_cameras_json(tmp_path / "cameras.json", one)
        svrgs("render", folder / "scene.ply", "--cameras", tmp_path / "cameras.json", "--out", tmp_path)
        pictures.append(read_pixels(next(tmp_path.glob("*.png")))[..., :3].astype(int))
        words = "view", str(folder / "scene.ply"), "--cameras", str(tmp_path / "cameras.json")
        looked = source_of(parser().parse_args(words))
        assert looked.unit == 1 if factor == 1 else looked.unit < 0.03
    assert pictures[0].any() and np.abs(pictures[0] - pictures[1]).max() <= 2


def test_views_that_stand_near_each_other_keep_their_unit_in_a_file(tmp_path):
    near, far = (in_their_unit(tiny_dataset.views()[:2], shift + np.zeros((1, 3))) for shift in (0.0, 100.0))
    for cameras in (near, far):
        write_cameras_json(tmp_path / "cameras.json", cameras)
        units = [camera.unit for camera in load_cameras_json(tmp_path / "cameras.json")]
        assert units == [camera.unit for camera in cameras]


def test_what_rounding_leaves_of_cameras_in_one_place_is_no_extent():
    for turn in np.linspace(0, 3, 7):
        views = [tiny_dataset.views()[0], tiny_dataset.views()[0].displaced(np.array([0, turn, 0, 0, 0, 0]))]
        assert in_their_unit(views, np.empty((0, 3)))[0].unit == 1


def test_the_child_process_of_a_check_knows_the_unit(capture):
    expected = sample_views(load_dataset(capture(SMALL)))
    for (camera, _), (other, _) in zip(expected, read_in_child(str(capture(SMALL)), ""), strict=True):
        assert camera.key == other.key and camera.unit < 1
