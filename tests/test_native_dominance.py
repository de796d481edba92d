"""Slopes of the colours in a Gaussian's value (Speedy-Splat), and the pixels that a Gaussian dominates,
against the float64 reference."""

from __future__ import annotations

import functools

import numpy as np
import pytest

import scenes
from native_helpers import LEVELS, frontal, isotropic, rasterizer, render
from reference import rasterize as reference
from svrgs_addon.native import library
from weights_of_pixels import expected_dominance, expected_slopes, parts

COUNT = 40
CAMERA = scenes.camera(37, 29)


@functools.cache
def sloped(masked: bool, antialiased: bool) -> tuple:
    """A scene with opaque Gaussians among others, its masks, and the slopes of the reference."""
    scene, _ = scenes.away_from_thresholds(
        scenes.random_scene(COUNT, 5, 1, scale=0.3), CAMERA, np.ones(COUNT)
    )
    scene.opacity_logits[:6] = 9.0
    masks = scenes.random_masks(scene.count, 3) if masked else np.ones(scene.count)
    return scene, masks, expected_slopes(scene, masks, CAMERA, antialiased)


@functools.cache
def dominated(masked: bool) -> tuple:
    """A scene, its masks, and how many pixels each Gaussian dominates in the reference."""
    scene, _ = scenes.away_from_thresholds(
        scenes.random_scene(COUNT, 6, 1, scale=0.3), CAMERA, np.ones(COUNT)
    )
    masks = scenes.random_masks(scene.count, 3) if masked else np.ones(scene.count)
    return scene, masks, expected_dominance(scene, masks, CAMERA)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("masked", [False, True])
@pytest.mark.parametrize("antialiased", [False, True])
def test_slopes_are_those_of_the_reference(level, masked, antialiased):
    """Opaque Gaussians among them, whose alpha is clamped. Worst seen, of the largest: 1e-15 in float64, 7e-7
    in float32."""
    scene, masks, expected = sloped(masked, antialiased)
    render(level, scene, CAMERA, masks, ("rgb",), antialiased=antialiased)
    found = np.zeros(scene.count)
    rasterizer(level).add_slopes(found)
    assert (expected > 0).sum() > 10 and (parts(scene, CAMERA)[1] == reference.ALPHA_MAX).any()
    np.testing.assert_allclose(
        found, expected, rtol=0, atol=(1e-13 if level == "float64" else 1e-5) * expected.max()
    )


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("masked", [False, True])
def test_each_pixel_is_dominated_by_its_largest_weight(level, masked):
    scene, masks, expected = dominated(masked)
    alpha = render(level, scene, CAMERA, masks, ("alpha",))["alpha"]
    found = np.zeros(scene.count)
    rasterizer(level).add_dominance(found)
    assert found.sum() == (alpha > 0).sum() and 5 < (found > 0).sum() < scene.count
    np.testing.assert_array_equal(found, expected)
    rasterizer(level).add_dominance(found)
    np.testing.assert_array_equal(found, 2 * expected)


@pytest.mark.usefixtures("default_threads")
@pytest.mark.parametrize("level", LEVELS)
def test_sums_do_not_depend_on_the_number_of_threads(level):
    scene, found = scenes.random_scene(300, 6, 1, scale=0.3), set()
    camera = scenes.camera(150, 130)
    for threads in (1, 2, 3):
        library.set_threads(threads)
        render(level, scene, camera, None, ("rgb",))
        sums = np.zeros(300), np.zeros(300)
        rasterizer(level).add_slopes(sums[0])
        rasterizer(level).add_dominance(sums[1])
        found.add(b"".join(array.tobytes() for array in sums))
    assert len(found) == 1


@pytest.mark.parametrize("level", LEVELS)
def test_of_equal_weights_the_nearest_dominates(level):
    """In front alpha is 1/2 at the middle of each pixel's ray, behind it 0.99 times 1/2; then the other way
    round."""
    camera = frontal(16, 16)
    for opacity, expected in (((0.5, 1 - 1e-9), (256, 0)), ((0.25, 1 - 1e-9), (0, 256))):
        render(
            level,
            isotropic([(0, 0, 4), (0, 0, 5)], scale=1e4, opacity=np.array(opacity)),
            camera,
            None,
            ("rgb",),
        )
        pixels = np.zeros(2)
        rasterizer(level).add_dominance(pixels)
        assert tuple(pixels) == expected
