"""What the library offers for measuring: skips turned off, work counts, stage times, peaks."""

from __future__ import annotations

import numpy as np
import pytest

import scenes
from native_helpers import IMAGES, LEVELS, assert_same_bits, backward, image_weights, rasterizer, render
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.system.errors import NativeError

CAMERA = scenes.camera(61, 43)


@pytest.fixture(scope="module")
def scene():
    return scenes.random_scene(120, 4, 2, scale=0.15)


def masks(scene):
    return scenes.random_masks(scene.count, 4)


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("skip", library.skips())
@pytest.mark.parametrize("level", LEVELS)
def test_a_skip_changes_no_image_and_no_gradient(scene, level, skip, full):
    results = []
    for disabled in ((), (skip,)):
        images = render(level, scene, CAMERA, masks(scene), full=full, disabled_skips=disabled)
        results.append(
            images
            | {f"d{name}": g for name, g in backward(level, image_weights(CAMERA), scene.count).items()}
        )
    assert_same_bits(
        *({name: image for name, image in result.items() if name in IMAGES} for result in results)
    )
    for name, values in results[0].items():  # another grouping of the same sums
        np.testing.assert_allclose(
            values, results[1][name], rtol=0, atol=2e-5 * max(1, np.abs(values).max()), err_msg=name
        )


@pytest.mark.parametrize("level", LEVELS)
def test_work_is_counted_alike_on_every_level_and_agrees_with_the_images(scene, level):
    images = render(level, scene, CAMERA, full=False)
    work = rasterizer(level).work(count_pixels=True)
    assert work["contributing"] == images["kept"].sum() <= work["hits"]
    assert work["hit_blocks"] <= work["blocks"] and work["used_pairs"] <= work["pairs"]
    assert work["evaluated"] == 16 * work["blocks"]
    assert work["visible"] == len(rasterizer(level).visible()) > 50
    images = render(level, scene, CAMERA)
    assert rasterizer(level).work(count_pixels=True)["hits"] == images["hits"].sum()


def test_skips_save_work(scene):
    def work(*disabled, full=False):
        render("scalar", scene, CAMERA, full=full, disabled_skips=disabled)
        return rasterizer("scalar").work(count_pixels=True)

    plain = work()
    assert work("exact_tiles")["pairs"] > plain["pairs"]
    assert work("opacity_bounds")["pairs"] > plain["pairs"]
    assert work("block_tests")["blocks"] > plain["blocks"]
    assert work("termination")["blocks"] >= plain["blocks"]


def test_counting_needs_a_view():
    with pytest.raises(NativeError, match="svrgs_forward"):
        Rasterizer("scalar").work(count_pixels=True)


def test_stages_take_time(scene):
    render("scalar", scene, CAMERA)
    backward("scalar", image_weights(CAMERA), scene.count)
    seconds = rasterizer("scalar").stage_seconds()
    assert tuple(seconds) == library.stages()
    assert all(0 < seconds[name] < 10 for name in library.stages() if name not in ("loss", "adam"))


def test_peaks_are_those_of_a_computer():
    peaks = library.peaks(library.best_level())
    assert 1e8 < peaks["fma"] < 1e14 and 1e7 < peaks["read"] < 1e13 and 1e7 < peaks["update"] < 1e13
