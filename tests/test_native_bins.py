"""Tiles are listed in bins of 4x4, or each by itself where there are few bins for many Gaussians. A picture
of many bins is what small pictures of its parts show, each of which has one bin, or lists of its tiles."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from native_helpers import LEVELS, backward, image_weights, rasterizer, relative_l2, render
from svrgs_addon.native import library
from svrgs_addon.native.library import traced
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.gaussians import Scene

WIDTH, HEIGHT, PART = 413, 301, 120  # a bin has 128 pixels; the image ends within a tile
# in perspective, the shape of large Gaussians is limited at the borders of a picture
WHOLE = scenes.parallel(scenes.camera(WIDTH, HEIGHT, fov=60))
OUTPUTS = ("rgb", "depth", "alpha", "mask", "hits")
ONE_BIN = 4096  # (Gaussian, tile) pairs at most: of more, a picture of one bin has a list for each tile


def mixed() -> Scene:
    """Gaussians of a fraction of a pixel up to such as cover the picture, some of which are needles, or lie
    at its borders."""
    parts = [
        scenes.random_scene(600, 1, 1, scale=0.02), scenes.random_scene(80, 2, 1, scale=0.3),
        scenes.random_scene(6, 3, 1, scale=3.0, opacity=-2.0),
        scenes.needles(30, 4, 1), scenes.near_camera(20, 5, 1),
    ]  # fmt: skip
    joined = {
        name: np.concatenate([getattr(part, name) for part in parts])
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    }
    return Scene(**joined)


def crowded() -> Scene:
    """So many that some parts of the picture have lists of tiles, while the whole has bins."""
    return scenes.random_scene(24_000, 6, 1, scale=0.012, opacity=-1.0)


def parts_of(camera):
    """(slices, camera) of each part of the picture."""
    for top in range(0, HEIGHT, PART):
        for left in range(0, WIDTH, PART):
            width, height = min(PART, WIDTH - left), min(PART, HEIGHT - top)
            K = camera.K.copy()
            K[:2, 2] -= left, top
            yield (
                (slice(top, top + height), slice(left, left + width)),
                replace(camera, K=K, width=width, height=height),
            )


@pytest.fixture(scope="module", params=[mixed, crowded], ids=lambda make: make.__name__)
def scene(request) -> Scene:
    return request.param()


def test_a_crowded_picture_of_one_bin_has_a_list_for_each_tile():
    rasterizer, scene, by_tile = Rasterizer(), crowded(), []
    library.set_threads(1)
    for camera in (WHOLE, *(part for _, part in parts_of(WHOLE))):
        jobs = traced(lambda: rasterizer.forward(scene, camera, RenderOptions()))  # noqa: B023
        bins = -(-camera.width // 128) * -(-camera.height // 128)
        tiles = -(-camera.width // 32) * -(-camera.height // 32)
        by_tile.append(rasterizer.work()["pairs"] > ONE_BIN * bins**2)
        assert len(jobs[-1]) == (2 * tiles if by_tile[-1] else 17 * bins)  # a list, and its tile or tiles
    library.set_threads(0)
    assert not by_tile[0] and any(by_tile) and not all(by_tile[1:])


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(
    "options", [{}, {"picture_only": True}, {"full": False}], ids=["kept", "picture_only", "visible_mask"]
)
def test_a_picture_of_many_bins_is_that_of_its_parts(scene, level, options):
    camera = WHOLE
    whole = {
        name: image.copy() for name, image in render(level, scene, camera, outputs=OUTPUTS, **options).items()
    }
    assert whole["hits"].max() > 10 and whole["alpha"].std() > 0.1
    for place, part in parts_of(camera):
        found = render(level, scene, part, outputs=OUTPUTS, **options)
        # alpha at its threshold, rounded otherwise
        crossed = np.abs(found["hits"] - whole["hits"][place]) > 0
        assert crossed.mean() < 1e-3
        for name in ("rgb", "depth", "alpha", "mask"):
            assert np.abs(found[name] - whole[name][place])[~crossed].max() < 2e-5 * max(
                1, np.abs(whole[name]).max()
            ), name


@pytest.mark.parametrize("level", LEVELS)
def test_gradients_of_many_bins_are_those_of_its_parts_together(scene, level):
    camera = WHOLE
    weights = image_weights(camera)
    render(level, scene, camera)
    whole = backward(level, weights, scene.count)
    total = {name: np.zeros(rows.shape) for name, rows in whole.items()}
    for place, part in parts_of(camera):
        render(level, scene, part)
        for name, rows in backward(
            level, {name: image[place] for name, image in weights.items()}, scene.count
        ).items():
            total[name] += rows
    for name, rows in whole.items():
        assert relative_l2(rows, total[name]) < 1e-4, name


@pytest.mark.parametrize("level", LEVELS)
def test_exact_tiles_leave_out_no_hit(level):
    """With the rectangles around them instead, Gaussians are in more tiles, and the picture is the same."""
    scene, camera, found, pairs = mixed(), scenes.camera(WIDTH, HEIGHT), [], []
    for disabled in ((), ("exact_tiles",)):
        found.append(
            {
                name: image.copy()
                for name, image in render(
                    level, scene, camera, outputs=OUTPUTS, disabled_skips=disabled
                ).items()
            }
        )
        pairs.append(rasterizer(level).work()["pairs"])
    assert pairs[0] < 0.9 * pairs[1]
    for name in OUTPUTS:
        assert found[0][name].tobytes() == found[1][name].tobytes(), name
