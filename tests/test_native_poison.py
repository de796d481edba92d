"""Poisoned values: the native core draws them finite or not at all, and no other Gaussian changes."""

from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from native_helpers import (
    ARRAYS,
    LEVELS,
    assert_finite,
    assert_in_range,
    assert_same_bits,
    frontal,
    isotropic,
    rasterizer,
    render,
    typed,
    view_and_gradients,
)

FLOAT_MAX = float(np.finfo(np.float32).max)


FINITE_POISON = (0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e38, -1e38, FLOAT_MAX, -FLOAT_MAX)
SLOTS = [(name, k) for name, width in zip(ARRAYS, (3, 3, 4, 1, 12), strict=True) for k in range(width)]


def poisoned(level, array: str, slot: int, value: float):
    """A scene whose Gaussian 5 has one bad value, the same scene without it, and which rows those are."""
    scene = scenes.random_scene(12, 1, 1, scale=0.3)
    others = np.arange(12) != 5
    bad = typed(scene, rasterizer(level).dtype)
    getattr(bad, array)[5].reshape(-1)[slot : slot + 1] = value
    if array == "opacity_logits":
        bad.opacity_logits[5] = value
    return bad, scene.select(others), others


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("array", "slot"), SLOTS)
@pytest.mark.parametrize("antialiased", [False, True])
def test_values_that_are_not_finite_draw_nothing(array, slot, level, antialiased):
    """The poisoned Gaussian is culled, its gradient zero, every other bit as without it."""
    camera = scenes.CAMERAS["rotated"]
    for value in (np.nan, np.inf, -np.inf):
        if array == "opacity_logits" and value == np.inf:
            continue  # an opacity of exactly 1: see below
        bad, without, others = poisoned(level, array, slot, value)
        images, grads = view_and_gradients(level, bad, camera, antialiased=antialiased)
        assert 5 not in rasterizer(level).visible()
        expected, expected_grads = view_and_gradients(level, without, camera, antialiased=antialiased)
        assert_same_bits(images, expected)
        assert not any(g[5].any() for g in grads.values())
        assert_same_bits({name: g[others] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("array", "slot"), SLOTS)
def test_extreme_finite_values_stay_finite(array, slot, level):
    """Drawn or culled; if culled, every other bit is as without it."""
    for name in ("plain", "rotated"):
        camera = scenes.CAMERAS[name]
        for value in FINITE_POISON:
            bad, without, others = poisoned(level, array, slot, value)
            images, grads = view_and_gradients(level, bad, camera)
            assert_in_range(images)
            assert_finite(grads)
            if 5 in rasterizer(level).visible():
                continue
            expected, expected_grads = view_and_gradients(level, without, camera)
            assert_same_bits(images, expected)
            assert_same_bits({name: g[others] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
def test_a_drawn_poison_leaves_pixels_it_does_not_touch(level):
    """A Gaussian in the left half, made very bright, opaque or small; the right half keeps its bits."""
    camera = frontal(64, 32)
    base = isotropic([(-1.0, 0, 2), (0.5, 0, 2), (1.0, 0.2, 3)], scale=0.1)
    others = SimpleNamespace(**{name: getattr(base, name)[1:].copy() for name in ARRAYS})
    expected = render(level, others, camera)["rgb"][:, 32:]
    poison = [("opacity_logits", np.inf), ("sh", 1e5), ("sh", -1e38), ("log_scales", -1e38), ("quats", 1e15)]
    for array, value in poison:
        bad = typed(base, np.float64)
        getattr(bad, array)[0] = value
        images, grads = view_and_gradients(level, bad, camera)
        assert 0 in rasterizer(level).visible() or array == "sh"
        assert_finite(images | grads)
        np.testing.assert_array_equal(images["rgb"][:, 32:], expected)


@pytest.mark.parametrize("level", LEVELS)
def test_hostile_quaternions_change_no_other_pixel(level):
    """500 Gaussians of zero, tiny, huge and non-finite quaternions among 20 good ones."""
    scene, crowd = scenes.random_scene(20, 1, 0, scale=0.3), scenes.random_scene(500, 2, 0, scale=0.3)
    lengths = np.array([0, 1e-44, 1e-30, 1e-25, 1e25, 1e37, np.inf, np.nan])
    crowd.quats[:] *= lengths[np.arange(500) % 8, None].astype(np.float32)
    both = typed(scene, np.float64)
    for name in ARRAYS:
        setattr(both, name, np.concatenate([getattr(both, name), getattr(crowd, name)]))
    images, grads = view_and_gradients(level, both, scenes.CAMERAS["plain"])
    expected, expected_grads = view_and_gradients(level, scene, scenes.CAMERAS["plain"])
    assert_same_bits(images, expected)
    assert_same_bits({name: g[:20] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
def test_length_of_a_quaternion_does_not_matter(level):
    scene, camera = scenes.random_scene(30, 1, 0, scale=0.3), scenes.CAMERAS["plain"]
    expected, expected_grads = view_and_gradients(level, scene, camera)
    for length in (1e-8, 1e-3, 1e3, 1e8):
        longer = typed(scene, np.float64)
        longer.quats *= length
        images, grads = view_and_gradients(level, longer, camera)
        np.testing.assert_allclose(images["rgb"], expected["rgb"], atol=2e-6)
        scale = np.abs(expected_grads["quats"]).max()
        np.testing.assert_allclose(grads["quats"] * length, expected_grads["quats"], atol=1e-4 * scale)
