"""Linear colours for Blender, against the sRGB transfer function in float64."""

from __future__ import annotations

import numpy as np
import pytest

from native_helpers import LEVELS
from svrgs_addon.files.images import srgb_to_linear
from svrgs_addon.native import library
from svrgs_addon.native.pictures import linear_colours

SRGB = np.eye(3)
# about that of Rec. 2020
WIDE = np.array([[0.627, 0.069, 0.016], [0.329, 0.920, 0.088], [0.043, 0.011, 0.896]])
BOUND = {"float64": 1e-14}  # of colours up to 1, absolute
FLOAT_BOUND = 4e-7  # worst seen: 3.5e-7


def expected(rgb: np.ndarray, alpha: np.ndarray, space: np.ndarray) -> np.ndarray:
    rgb, alpha = rgb.astype(np.float64), alpha.astype(np.float64)[..., None]
    straight = np.divide(rgb, alpha, out=np.zeros_like(rgb), where=alpha > 0)
    curve = ((np.maximum(straight, 0) + 0.055) / 1.055) ** 2.4
    linear = np.where(straight <= 0.04045, straight / 12.92, curve)
    return np.concatenate([linear @ space * alpha, alpha], axis=-1)


def drawn(height: int, width: int, dtype) -> tuple[np.ndarray, np.ndarray]:
    """Colours from 0 to 1, some of them at the seam of the curve, times alpha; some pixels are clear."""
    rng = np.random.default_rng(4)
    alpha = np.where(rng.random((height, width)) < 0.2, 0, rng.random((height, width))).astype(dtype)
    straight = rng.random((height, width, 3)) ** 3
    straight[:, ::5] = 0.04045 + rng.uniform(-1e-3, 1e-3, straight[:, ::5].shape)
    return (straight * alpha[..., None]).astype(dtype), alpha


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("space", [SRGB, WIDE], ids=["srgb", "wide"])
# ends within a vector, and within a task of the pool
@pytest.mark.parametrize("size", [(1, 1), (3, 37), (90, 101)], ids=str)
def test_linear_colours_are_those_of_the_transfer_function(level, space, size):
    rgb, alpha = drawn(*size, np.float64 if level == "float64" else np.float32)
    found = linear_colours(rgb, alpha, space, level)
    assert found.shape == (*size, 4) and found.dtype == rgb.dtype
    assert np.abs(found - expected(rgb, alpha, space)).max() <= BOUND.get(level, FLOAT_BOUND)
    np.testing.assert_array_equal(found[..., 3], alpha)
    assert not found[alpha == 0].any()


@pytest.mark.parametrize("level", LEVELS)
def test_colours_outside_0_to_1_follow_the_same_formulas(level):
    dtype = np.float64 if level == "float64" else np.float32
    values = np.array([-3.0, -0.2, -1e-9, 0.0, 1.0, 1.5, 40.0, 1e6], dtype)
    rgb, alpha = np.repeat(values[None, :, None], 3, axis=2), np.ones((1, len(values)), dtype)
    found = linear_colours(rgb, alpha, SRGB, level)[0, :, 0]
    np.testing.assert_allclose(
        found, expected(rgb, alpha, SRGB)[0, :, 0], rtol=5e-6 if dtype == np.float32 else 1e-12
    )
    np.testing.assert_allclose(found, srgb_to_linear(values), rtol=5e-6)
    assert np.isfinite(linear_colours(np.full_like(rgb, 1e30), np.full_like(alpha, 1e-3), SRGB, level)).all()


def test_the_number_of_threads_changes_no_bit():
    rgb, alpha = drawn(90, 101, np.float32)
    found = []
    for threads in (1, 2, 7):
        library.set_threads(threads)
        found.append(linear_colours(rgb, alpha, WIDE).tobytes())
    library.set_threads(0)
    assert found[0] == found[1] == found[2]


def test_other_arrays_are_refused():
    rgb, alpha = drawn(4, 5, np.float32)
    with pytest.raises(TypeError, match="rgb"):
        linear_colours(rgb[:, :4], alpha, SRGB)
    with pytest.raises(TypeError, match="alpha"):
        linear_colours(rgb, alpha.astype(np.float64), SRGB)
    assert linear_colours(rgb[:0], alpha[:0], SRGB).shape == (0, 5, 4)
    with pytest.raises(TypeError, match="working_space"):
        linear_colours(rgb, alpha, SRGB[:2])
