"""The native FLIP against the reference, on sizes of one and of several tiles, and itself on other
threads."""

import numpy as np
import pytest

from native_helpers import FLOAT_LEVELS, LEVELS
from reference import flip as reference
from svrgs_addon.native import library
from svrgs_addon.native.pictures import flip_errors
from svrgs_addon.system.errors import NativeError

pytestmark = pytest.mark.usefixtures("default_threads")

# worst seen 3.7e-5, scalar and baseline: FLIP takes the square root of feature differences, so small rounding
# errors grow
PIXEL_BOUND = 5e-5
MEAN_BOUND = 5e-7  # worst seen 3.5e-7, scalar and baseline
SIZES = [(1, 1), (1, 40), (7, 5), (32, 128), (33, 129), (95, 300)]  # the last two have four and nine tiles
PPD = 67.0206


def image_pair(height: int, width: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """A smooth image in [0, 1], a part of it black or white, and a noisy copy; a quarter of the pixels are
    equal."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[:height, :width][..., None]
    image = np.clip(0.5 + 0.7 * np.sin(0.1 * x + np.arange(3)) * np.cos(0.07 * y), 0, 1)
    noise = rng.normal(0, 0.1, image.shape) * (x > width / 4)
    return image, np.clip(image + noise, 0, 1)


def native_flip(level: str, a: np.ndarray, b: np.ndarray, ppd: float = PPD) -> np.ndarray:
    dtype = np.float64 if level == "float64" else np.float32
    return flip_errors(np.ascontiguousarray(a, dtype), np.ascontiguousarray(b, dtype), ppd, level)


@pytest.mark.parametrize("ppd", [1.0, 5.0, 30.0, PPD, 150.0])
@pytest.mark.parametrize("size", SIZES)
def test_float64_flip_equals_the_reference(size, ppd):
    images = image_pair(*size)
    np.testing.assert_allclose(
        native_flip("float64", *images, ppd), reference.flip_map(*images, ppd), rtol=0, atol=1e-11
    )


@pytest.mark.parametrize("level", FLOAT_LEVELS)
@pytest.mark.parametrize("size", SIZES)
def test_float_flip_agrees_with_the_reference(size, level):
    for seed in range(3):
        images = [image.astype(np.float32) for image in image_pair(*size, seed)]
        found = native_flip(level, *images)
        expected = reference.flip_map(*(image.astype(np.float64) for image in images), PPD)
        assert np.abs(found - expected).max() <= PIXEL_BOUND
        assert abs(found.mean(dtype=np.float64) - expected.mean()) <= MEAN_BOUND


@pytest.mark.parametrize("level", LEVELS)
def test_equal_images_have_no_difference_and_order_does_not_matter(level):
    a, b = image_pair(40, 150)
    assert not native_flip(level, a, a).any()
    np.testing.assert_array_equal(native_flip(level, a, b), native_flip(level, b, a))


@pytest.mark.parametrize("level", LEVELS)
def test_flat_images_differ_by_their_colours_only(level):
    """A difference of features as small as 1e-9 would change the result by 1e-5."""
    black, grey = np.zeros((40, 150, 3)), np.full((40, 150, 3), 0.3)
    found = native_flip(level, black, grey)
    assert (
        found.min()
        == found.max()
        == pytest.approx(reference.flip_map(black[:3, :3], grey[:3, :3], PPD)[1, 1], abs=2e-6)
    )


def test_flip_does_not_depend_on_threads():
    a, b = image_pair(95, 300)
    found = []
    for threads in (1, 3, 7):
        library.set_threads(threads)
        found.append(native_flip(library.best_level(), a, b))
    assert (found[0] == found[1]).all() and (found[0] == found[2]).all()


@pytest.mark.parametrize("ppd", [0.0, 0.9, -1.0, 401.0, np.nan])
def test_other_viewers_are_refused(ppd):
    with pytest.raises(NativeError, match="pixels per degree"):
        native_flip(library.best_level(), *image_pair(8, 8), ppd)
