"""Gradients of the native float64 are the finite differences of its own images."""

import functools
import math

import numpy as np
import pytest

import scenes
from native_helpers import ARRAYS, FLOAT_IMAGES, backward, image_weights, render, typed

DIFFERENCE_CASES = {
    "plain": (scenes.random_scene(6, 1, 3, scale=0.3), scenes.camera(9, 7), {}),
    "antialiased": (
        scenes.random_scene(8, 2, 1, scale=0.2, antialiased=True),
        scenes.CAMERAS["rotated"].resized(10, 8),
        {"mask_kind": "b"},
    ),
    "scenario_a": (
        scenes.random_scene(8, 3, 2, scale=0.3),
        scenes.camera(7, 9, shift=(0.4, -0.3)),
        {"mask_kind": "a"},
    ),
    "stopping": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {}),
    "stopping_visible": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"full": False}),
    "clamped": (scenes.off_screen(8, 5, 0), scenes.camera(6, 8), {}),
    "orthographic": (
        scenes.random_scene(6, 6, 3, scale=0.3),
        scenes.parallel(scenes.CAMERAS["rotated"].resized(9, 7)),
        {},
    ),
    "orthographic_antialiased": (
        scenes.random_scene(8, 7, 2, scale=0.2, antialiased=True),
        scenes.parallel(scenes.camera(8, 9, shift=(0.4, -0.3), aspect=0.8)),
        {"mask_kind": "b"},
    ),
}


@functools.cache
def difference_case(name: str):
    scene, camera, options = DIFFERENCE_CASES[name]
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(scene.count, 7))
    assert scene.count >= 6 and 0 < masks.sum() < len(masks)
    return scene, masks, camera, options | {"antialiased": scene.antialiased}


@pytest.mark.parametrize("name", DIFFERENCE_CASES)
def test_every_gradient_is_the_finite_difference(name):
    scene, masks, camera, options = difference_case(name)
    # F has a gradient to masks only
    weights = {k: w / w[..., :1].size for k, w in image_weights(camera).items() if k != "mask"}
    params = typed(scene, np.float64)

    def value() -> float:
        images = render("float64", params, camera, masks, FLOAT_IMAGES, **options)
        return math.fsum((images[k] * w).sum() for k, w in weights.items())

    value()
    grads = backward("float64", weights, scene.count, ARRAYS)
    for array in ARRAYS:
        values, difference = getattr(params, array).reshape(-1), np.zeros(getattr(params, array).size)
        for i, x in enumerate(values.copy()):
            sides = []
            for values[i] in (x - 1e-6, x + 1e-6):
                sides.append(value())
            values[i] = x
            difference[i] = (sides[1] - sides[0]) / 2e-6
        assert np.abs(difference).max() > 1e-4, array
        np.testing.assert_allclose(grads[array].ravel(), difference, rtol=1e-6, atol=2e-9, err_msg=array)


@pytest.mark.parametrize("kind", ["svr", "b"])
def test_mask_gradient_is_the_difference_between_present_and_absent(kind):
    """C, depth, alpha, F and F_B are linear in each M_i: where nothing stops, the step from 0 to 1 is the
    derivative."""
    scene, camera = scenes.random_scene(12, 3, 1, scale=0.3, opacity=0.0), scenes.camera(21, 18)
    masks, weights = scenes.random_masks(12, 3, keep=0.5), image_weights(camera)
    assert render("float64", scene, camera, np.ones(12))["transmittance"].min() > 2e-4

    def value(masks: np.ndarray) -> float:
        images = render("float64", scene, camera, masks, mask_kind=kind)
        return math.fsum((images[k] * w).sum() for k, w in weights.items())

    value(masks)
    gradient = backward("float64", weights, 12, ("masks",))["masks"]
    for i in range(12):
        present, absent = (np.where(np.arange(12) == i, m, masks) for m in (1, 0))
        assert gradient[i] == pytest.approx(value(present) - value(absent), rel=1e-10, abs=1e-10)
    assert (np.abs(gradient) > 1e-3).all()
