"""`svrgs view`: what its picture shows, and the page in a real browser."""

from __future__ import annotations

import argparse
import re
import signal
import subprocess
import sys
import urllib.request
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import browser
from scenes import random_scene
from svrgs_addon.cli.view_scenes import source_of
from svrgs_addon.files.images import to_bytes
from svrgs_addon.files.ply import write_ply
from svrgs_addon.files.registry import write_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.report.pictures import mask_to_rgb
from svrgs_addon.render.metrics.evaluate import evaluate, picture_options
from svrgs_addon.scene.rotations import quats_from_matrices
from svrgs_addon.system import packages
from svrgs_addon.system.errors import SceneError
from svrgs_addon.viewer.server import LARGEST, Viewer, camera_of
from svrgs_addon.viewer.shown import DIFFERENCE, MASK, Shown, drawn
from svrgs_addon.viewer.source import Source, fov_of
from svrgs_bench.scenes import orbit_camera, room

CAMERA = orbit_camera(120, 80)
ORIGINAL, PRUNED = room(3_000), room(3_000).select(slice(700))


def whole(scene, camera=CAMERA, output="rgb") -> np.ndarray:
    options = picture_options(scene, mask_kind="svr" if output == "mask" else "none")
    return Rasterizer().forward(scene, camera, options, outputs=(output,))[output]


@pytest.mark.parametrize("share", [0.0, 0.3, 1.0])
def test_the_wipe_shows_the_original_left_of_it_and_the_pruned_scene_right_of_it(share):
    picture = drawn(Rasterizer(), Shown((ORIGINAL, PRUNED), share=share), CAMERA)
    edge = round(share * CAMERA.width)
    left, right = (to_bytes(whole(scene)) for scene in (ORIGINAL, PRUNED))
    assert (left != right).any()
    np.testing.assert_array_equal(picture[:, :edge], left[:, :edge])
    np.testing.assert_array_equal(picture[:, edge:], right[:, edge:])


def test_masks_of_both_scenes_have_the_same_colours():
    picture = drawn(Rasterizer(), Shown((ORIGINAL, PRUNED), MASK), CAMERA)
    a, b = (whole(scene, output="mask") for scene in (ORIGINAL, PRUNED))
    top = max(a[:, :60].max(), b[:, 60:].max())
    np.testing.assert_array_equal(picture[:, :60], mask_to_rgb(a, top)[:, :60])
    np.testing.assert_array_equal(picture[:, 60:], mask_to_rgb(b, top)[:, 60:])


def test_a_difference_is_that_of_the_clipped_pictures_four_times():
    picture = drawn(Rasterizer(), Shown((ORIGINAL, PRUNED), DIFFERENCE), CAMERA)
    a, b = (np.clip(whole(scene), 0, 1) for scene in (ORIGINAL, PRUNED))
    np.testing.assert_array_equal(picture, to_bytes(4 * np.abs(a - b)))


def test_one_scene_is_shown_whole_over_its_background():
    picture = drawn(Rasterizer(), Shown((PRUNED,), background=(0.0, 1.0, 0.0)), CAMERA)
    options = picture_options(PRUNED, (0.0, 1.0, 0.0))
    np.testing.assert_array_equal(picture, to_bytes(Rasterizer().forward(PRUNED, CAMERA, options)["rgb"]))


def test_the_first_gaussians_are_those_of_the_file_and_are_not_copied():
    scene = replace(ORIGINAL, attributes={"rank": np.arange(3_000, dtype=np.float32)})
    part = scene.select(slice(10))
    assert part.count == 10 and np.shares_memory(part.sh, scene.sh)
    np.testing.assert_array_equal(part.means, scene.means[:10])


def test_a_browser_sees_what_the_camera_sees():
    looking = SimpleNamespace(
        wxyz=quats_from_matrices(CAMERA.viewmat[None, :3, :3].swapaxes(1, 2))[0],
        position=CAMERA.position,
        fov=fov_of(CAMERA),
        image_width=120,
        image_height=80,
    )
    found = camera_of(looking, 0.01)
    np.testing.assert_allclose(found.viewmat, CAMERA.viewmat, atol=1e-12)
    np.testing.assert_allclose(found.K, CAMERA.K, atol=1e-9)
    assert found.unit == 0.01
    large = camera_of(SimpleNamespace(**{**vars(looking), "image_width": 12_000, "image_height": 8_000}), 1.0)
    assert max(large.width, large.height) == LARGEST


def arguments(*scenes: Path, **others) -> argparse.Namespace:
    usual = {"data": None, "cameras": None, "force": False, "nested": False, "background": (0, 0, 0)}
    usual |= {"port": 8080}
    return argparse.Namespace(scenes=list(scenes), **{**usual, **others})


def test_what_cannot_be_shown_is_one_sentence(tmp_path, svrgs, monkeypatch):
    write_ply(tmp_path / "a.ply", ORIGINAL)
    (tmp_path / "b.ply").write_bytes(b"ply\n")
    with pytest.raises(SceneError, match="at most two"):
        source_of(arguments(*[tmp_path / "a.ply"] * 3))
    with pytest.raises(SceneError, match="leave one out"):
        source_of(arguments(tmp_path / "a.ply", data=tmp_path, cameras=tmp_path / "c.json"))
    with pytest.raises(SceneError, match="at most 65000"):
        source_of(arguments(tmp_path / "a.ply", port=70_000))
    write_scene(tmp_path / "a.spz", ORIGINAL)
    with pytest.raises(SceneError, match="holds no nested result"):
        source_of(arguments(tmp_path / "a.spz", nested=True))
    assert "b.ply" in svrgs("view", tmp_path / "a.ply", tmp_path / "b.ply").err

    def missing(name, purpose):
        raise SceneError(f"{purpose} needs the package {name}")

    monkeypatch.setattr(packages, "load", missing)
    done = svrgs("view", tmp_path / "a.ply", "--no-browser")
    assert done.status == 2 and "needs the package viser" in done.err


def test_the_colours_of_a_measured_file_can_be_chosen():
    measured = {"removal_rank": np.zeros(3_000, np.float32), "other": np.zeros(3_000, np.float32)}
    scene = replace(ORIGINAL, attributes=measured)
    assert Source(("a",), (scene,), []).columns() == {"Removal error, as a rank": "removal_rank"}
    assert Source(("a", "b"), (scene, PRUNED), []).columns() == {}


@pytest.mark.slow
def test_another_captures_photographs_are_refused(tmp_path, tiny):
    pytest.importorskip("viser")
    write_ply(tmp_path / "s.ply", random_scene(300, seed=1))
    with pytest.raises(SceneError, match="another capture|none of its Gaussians"):
        source_of(arguments(tmp_path / "s.ply", data=tiny.folder))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        ((), r"(http://127\.0\.0\.1:\d+) shows a\.ply; Ctrl-C ends it"),
        (("--json",), r'\{"url": "(http://127\.0\.0\.1:\d+)", "scenes": \["[^"]*a\.ply"\]\}$'),
    ],
)
def test_the_command_serves_this_machine_until_it_is_interrupted(tmp_path, words, expected):
    pytest.importorskip("viser")
    write_ply(tmp_path / "a.ply", ORIGINAL)
    command = [sys.executable, "-m", "svrgs_addon", "view", tmp_path / "a.ply", "--no-browser", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
        said = process.stdout.readline()
        url = re.match(expected, said)[1]
        with urllib.request.urlopen(url) as page:
            assert b"<html" in page.read(1_000)
        process.send_signal(signal.SIGINT)
        try:
            assert process.wait(30) == 0
        finally:
            process.kill()


@pytest.mark.slow
@pytest.mark.skipif(browser.PROGRAM is None, reason="needs Chromium")
def test_a_browser_shows_the_pictures_of_the_native_renderer():
    pytest.importorskip("viser")
    cameras = [orbit_camera(300, 200, turn) for turn in (0, 90, 180, 270)]
    viewer = Viewer(Source(("a.ply", "b.ply"), (ORIGINAL, PRUNED), cameras), 8080)
    try:
        with browser.Browser(viewer.url) as page:
            page.until(viewer.server.get_clients)
            client = next(iter(viewer.server.get_clients().values()))
            page.until(lambda: client.camera.image_height)
            alike = lambda: psnr(page, drawn(Rasterizer(), viewer.shown, camera_of(client.camera, 1.0))) > 35
            for colors in ("Colors", MASK):
                viewer._colors.value = colors
                page.until(alike)
            foreign = [
                url for url in page.requests if not url.startswith((viewer.url, "data:", "blob:", "ws://127"))
            ]
            assert page.requests and not foreign
            viewer._view.value = 2
            viewer._visit(SimpleNamespace(client=client))
            page.until(lambda: np.allclose(client.camera.position, cameras[2].position, atol=1e-3))
            page.until(alike)
    finally:
        viewer.close()


def psnr(page: browser.Browser, picture: np.ndarray) -> float:
    """Between the page and a picture, where the page has no controls and notes."""
    a, b = (image[180:400, 120:540].astype(float) for image in (page.picture(), picture))
    return 10 * np.log10(255**2 / max(1e-9, ((a - b) ** 2).mean()))


@pytest.mark.slow
def test_the_figures_of_a_view_are_those_of_eval(data):
    pytest.importorskip("viser")
    viewer = Viewer(Source(("a.ply",), (PRUNED,), data.cameras, data), 8080)
    try:
        figures = evaluate(PRUNED, data, [3], Rasterizer())
        assert viewer.quality(3) == [
            f"a.ply: PSNR {figures['psnr']:.2f} dB, SSIM {figures['ssim']:.3f}, FLIP {figures['flip']:.3f}"
        ]
    finally:
        viewer.close()


@pytest.mark.slow
def test_columns_of_both_scenes_have_the_same_colours_and_the_newest_control_counts():
    pytest.importorskip("viser")
    column = lambda scene, value: replace(
        scene, attributes={"deciding_views": np.full(scene.count, value, np.float32)}
    )
    viewer = Viewer(Source(("a", "b"), (column(ORIGINAL, 2), column(PRUNED, 40)), []), 8080)
    try:
        viewer._colors.value = "Deciding views"
        viewer._change()
        few, many = (scene.sh[0, 0] for scene in viewer.shown.scenes)
        assert viewer.shown.colors == "Colors" and not np.allclose(few, many)
        viewer._colors.value = "Colors"
        viewer._change()
        np.testing.assert_array_equal(viewer.shown.scenes[0].sh, ORIGINAL.sh)
        assert viewer.server.request_share_url() is None
    finally:
        viewer.close()
