"""What the library offers for measuring: skips turned off, work counts, stage times, peaks; and 16-bit SH."""

from __future__ import annotations

import numpy as np
import pytest

import scenes
from native_helpers import BACKGROUND, FLOAT_LEVELS, IMAGES, LEVELS, assert_same_bits, backward, image_weights, rasterizer, render, typed
from svrgs_addon import native
from svrgs_addon.errors import NativeError
from svrgs_addon.native import SKIPS, RenderOptions

CAMERA = scenes.camera(61, 43)


@pytest.fixture(scope="module")
def scene():
    return scenes.random_scene(120, 4, 2, scale=0.15)


def masks(scene):
    return scenes.random_masks(scene.count, 4)


@pytest.mark.parametrize("full", [True, False])
@pytest.mark.parametrize("skip", SKIPS)
@pytest.mark.parametrize("level", LEVELS)
def test_a_skip_changes_no_image_and_no_gradient(scene, level, skip, full):
    results = []
    for without in ((), (skip,)):
        images = render(level, scene, CAMERA, masks(scene), full=full, without=without)
        results.append(images | {f"d{name}": g for name, g in backward(level, image_weights(CAMERA), scene.count).items()})
    assert_same_bits(*({name: image for name, image in result.items() if name in IMAGES} for result in results))
    for name, values in results[0].items():  # another grouping of the same sums
        np.testing.assert_allclose(values, results[1][name], rtol=0, atol=2e-5 * max(1, np.abs(values).max()), err_msg=name)


@pytest.mark.parametrize("level", LEVELS)
def test_work_is_counted_alike_on_every_level_and_agrees_with_the_images(scene, level):
    images = render(level, scene, CAMERA, full=False)
    work = rasterizer(level).work(count_pixels=True)
    assert work["contributing"] == images["kept"].sum() <= work["hits"]
    assert work["hit_blocks"] <= work["blocks"] and work["used_pairs"] <= work["pairs"] and work["evaluated"] == 16 * work["blocks"]
    assert work["visible"] == len(rasterizer(level).visible()) > 50
    images = render(level, scene, CAMERA)
    assert rasterizer(level).work(count_pixels=True)["hits"] == images["hits"].sum()


def test_skips_save_work(scene):
    def work(*without, full=False):
        render("scalar", scene, CAMERA, full=full, without=without)
        return rasterizer("scalar").work(count_pixels=True)

    plain = work()
    assert work("exact_tiles")["pairs"] > plain["pairs"]
    assert work("opacity_bounds")["pairs"] > plain["pairs"]
    assert work("block_tests")["blocks"] > plain["blocks"]
    assert work("termination")["blocks"] >= plain["blocks"]


def test_counting_needs_a_view():
    with pytest.raises(NativeError, match="svrgs_forward"):
        native.Rasterizer("scalar").work(count_pixels=True)


def test_stages_take_time(scene):
    render("scalar", scene, CAMERA)
    backward("scalar", image_weights(CAMERA), scene.count)
    seconds = rasterizer("scalar").stage_seconds()
    assert tuple(seconds) == native.STAGES
    assert all(0 < seconds[name] < 10 for name in native.STAGES if name not in ("loss", "adam"))


def test_peaks_are_those_of_a_computer():
    peaks = native.peaks(native.best_level())
    assert 1e8 < peaks["fma"] < 1e14 and 1e7 < peaks["read"] < 1e13 and 1e7 < peaks["update"] < 1e13


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("level", FLOAT_LEVELS)
def test_half_sh_is_the_same_picture_to_half_precision(level, degree):
    scene = typed(scenes.random_scene(60, 6, degree, scale=0.2), np.float32)
    r, options = rasterizer(level), RenderOptions(background=BACKGROUND)
    exact = r.forward(scene, CAMERA, options)["rgb"].copy()
    scene.sh = scene.sh.astype(np.float16)
    rounded = r.forward(scene, CAMERA, options)["rgb"]
    assert 0 < np.abs(rounded - exact).max() < 4e-3  # 16 coefficients of up to 2 or so, each off by up to 2^-11
    widened = typed(scene, np.float32)
    widened.sh = scene.sh.astype(np.float32)
    np.testing.assert_array_equal(rounded, r.forward(widened, CAMERA, options)["rgb"])


def test_a_view_of_half_sh_has_no_gradients():
    scene = typed(scenes.random_scene(20, 6, 1), np.float32)
    scene.sh = scene.sh.astype(np.float16)
    r = native.Rasterizer("scalar")
    r.forward(scene, CAMERA)
    with pytest.raises(NativeError, match="16-bit"):
        r.backward({"rgb": np.zeros((CAMERA.height, CAMERA.width, 3), np.float32)})
    with pytest.raises(TypeError, match="sh is float16"):
        native.Rasterizer("float64").forward(typed(scene, np.float64).__class__(**{**vars(typed(scene, np.float64)), "sh": scene.sh}), CAMERA)
