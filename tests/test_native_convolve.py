"""The native layer of VGG16 against its definition in float64, at every level, and itself on other
threads."""

import numpy as np
import pytest

from native_helpers import FLOAT_LEVELS, LEVELS
from svrgs_addon.native import library
from svrgs_addon.native.pictures import PANEL, convolved, filter_panels
from svrgs_addon.system.errors import NativeError

pytestmark = pytest.mark.usefixtures("default_threads")

# (height, width, inputs, outputs): one pixel; edges alone; blocks of pixels and a rest; several parts of the
# values
SIZES = [(1, 1, 3, 32), (2, 2, 5, 32), (5, 33, 3, 64), (3, 40, 70, 96)]
BOUND = 4e-7  # of the sum of the products' magnitudes; worst seen 2.2e-7, of 4,608 products


def layer(height: int, width: int, inputs: int, outputs: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    rng = np.random.default_rng(height * width)
    image = rng.normal(0, 1, (height, width, inputs))
    return image, rng.normal(0, 1, (outputs, inputs, 3, 3)), rng.normal(0, 1, outputs)


def products(image: np.ndarray, filters: np.ndarray) -> np.ndarray:
    """The definition of a convolution, with zeros around the image."""
    around = np.pad(image, ((1, 1), (1, 1), (0, 0)))
    neighbours = np.lib.stride_tricks.sliding_window_view(around, (3, 3), axis=(0, 1))
    return np.einsum("hwcyx,ocyx->hwo", neighbours, filters)


def native(level: str, image: np.ndarray, filters: np.ndarray, bias: np.ndarray) -> np.ndarray:
    dtype = np.float64 if level == "float64" else np.float32
    return convolved(image.astype(dtype), filter_panels(filters.astype(dtype)), bias.astype(dtype), level)


@pytest.mark.parametrize("size", SIZES)
def test_float64_is_the_definition(size):
    image, filters, bias = layer(*size)
    expected = np.maximum(products(image, filters) + bias, 0)
    np.testing.assert_allclose(native("float64", image, filters, bias), expected, rtol=0, atol=1e-12)
    assert (expected == 0).any() and (expected > 0).any()


@pytest.mark.parametrize("level", FLOAT_LEVELS)
@pytest.mark.parametrize("size", SIZES)
def test_floats_agree_with_the_definition(size, level):
    image, filters, bias = (values.astype(np.float32).astype(np.float64) for values in layer(*size))
    expected = np.maximum(products(image, filters) + bias, 0)
    magnitudes = products(np.abs(image), np.abs(filters)) + np.abs(bias)
    assert (np.abs(native(level, image, filters, bias) - expected) <= BOUND * magnitudes).all()


@pytest.mark.parametrize("level", LEVELS)
def test_results_do_not_depend_on_threads(level):
    arrays = layer(*SIZES[2])
    results = []
    for count in (1, 2, 3, 8):
        library.set_threads(count)
        results.append(native(level, *arrays))
    assert all(np.array_equal(results[0], result) for result in results)


def test_bad_arguments_are_refused():
    image, panels = np.zeros((4, 4, 3), np.float32), filter_panels(np.zeros((32, 3, 3, 3), "f"))
    bias = np.zeros(32, "f")
    for arrays in (
        (image[:, ::2], panels, bias),
        (image, panels, bias[:-1]),
        (image, panels.astype("d"), bias),
    ):
        with pytest.raises(TypeError, match="expected C-contiguous"):
            convolved(*arrays)
    with pytest.raises(NativeError, match="image sides must be 1 to 32768 pixels"):
        convolved(np.zeros((0, 4, 3), np.float32), panels, bias)
    with pytest.raises(NativeError, match="there must be 1 to 4096 channels"):
        convolved(image, np.zeros((0, 3, 3, 3, PANEL), np.float32), np.zeros(0, np.float32))
