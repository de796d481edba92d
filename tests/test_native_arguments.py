"""Absurd sizes and wrong arguments: the native core refuses them, and its Python layer before it."""

import time
from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from native_helpers import IMAGES, LEVELS, frontal, isotropic, rasterizer, render, typed
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions, sample_masks
from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import NativeError

# --- sizes


REFUSED_SIZES = [(0, 5), (5, 0), (-1, 5), (5, -3), (32_769, 1), (1, 32_769), (2**31 - 1, 2**31 - 1)]


@pytest.mark.parametrize(("width", "height"), REFUSED_SIZES)
def test_image_sizes_outside_the_limits_are_refused(width, height):
    r = rasterizer("scalar")
    camera = Camera(np.eye(4), np.eye(3), width, height)
    with pytest.raises(NativeError, match="1 to 32768"):
        r.forward(typed(scenes.random_scene(3), r.dtype), camera, outputs=())


@pytest.mark.parametrize(("width", "height"), [(32_768, 1), (1, 32_768)])
def test_longest_images_work(width, height):
    images = render("scalar", isotropic([(0, 0, 2)], scale=1e5), frontal(width, height), outputs=("hits",))
    assert (images["hits"] == 1).all()


def test_too_many_pairs_are_refused_with_their_number():
    r, camera = rasterizer("scalar"), scenes.camera(64, 48)
    scene = typed(isotropic([(0, 0, z) for z in range(10)], scale=1e3), r.dtype)
    r.forward(scene, camera, RenderOptions(max_pairs=40))
    assert r.work()["pairs"] == 10 * 2 * 2
    with pytest.raises(NativeError, match=r"40 .* pairs.* 39"):
        r.forward(scene, camera, RenderOptions(max_pairs=39))
    with pytest.raises(NativeError):  # there is no view to differentiate now
        r.backward({})


def test_more_pairs_than_an_index_holds_are_refused_before_allocation():
    """2,400 Gaussians on each of 1024² tiles: 2.5e9 pairs would need 60 GB."""
    r = Rasterizer()
    scene = typed(isotropic([(0, 0, 2 + 0.01 * k) for k in range(2400)], scale=1e5), r.dtype)
    start = time.monotonic()
    with pytest.raises(NativeError, match=f"{2400 * 1024**2} .* pairs.* {2**31 - 1}"):
        r.forward(scene, frontal(32_768, 32_768, focal=2e4), outputs=())
    assert time.monotonic() - start < 5


@pytest.mark.parametrize(
    "change",
    [
        {"K": np.diag([0.0, 20, 1])},
        {"K": np.diag([20.0, -20, 1])},
        {"K": np.diag([np.inf, 20, 1])},
        {"K": np.diag([np.nan, 20, 1])},
        {"K": np.array([[20.0, 0, np.nan], [0, 20, 0], [0, 0, 1]])},
        {"viewmat": np.full((4, 4), np.nan)},
        {"viewmat": np.diag([1, 1, np.inf, 1])},
        {"orthographic": 2},
    ],
)
def test_broken_cameras_are_refused(change):
    r, camera = rasterizer("scalar"), frontal(5, 5)
    broken = Camera(**{"viewmat": camera.viewmat, "K": camera.K, "width": 5, "height": 5} | change)
    with pytest.raises(NativeError, match="camera|focal|orthographic"):
        r.forward(typed(scenes.random_scene(3), r.dtype), broken)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"background": (0, np.nan, 0)}, NativeError),
        ({"sh_degree": -1}, NativeError),
        ({"mask_kind": "a", "eps_a": 0.0}, NativeError),
        ({"mask_kind": "a", "eps_a": np.nan}, NativeError),
        ({"stop": 1.5}, NativeError),
        ({"stop": np.nan}, NativeError),
        ({"stop": 0.5, "mask_kind": "svr"}, NativeError),
        ({"mask_kind": "nonsense"}, (KeyError, ValueError)),
    ],
)
def test_broken_options_are_refused(options, error):
    r = rasterizer("scalar")
    with pytest.raises(error):
        r.forward(typed(scenes.random_scene(3), r.dtype), frontal(5, 5), RenderOptions(**options))


def test_calls_out_of_order_are_refused():
    r = Rasterizer("scalar")
    scores = np.zeros(3), np.zeros(3, np.float32), np.zeros(3, np.int64)
    for call in (lambda: r.backward({}), lambda: r.add_scores(*scores)):
        with pytest.raises(NativeError, match="forward"):
            call()
    r.forward(typed(scenes.random_scene(3), r.dtype), frontal(5, 5), outputs=("rgb",))
    with pytest.raises(NativeError, match="depth"):
        r.backward({"depth": np.ones((5, 5), r.dtype)})


def test_unknown_names_are_refused():
    r, ones = Rasterizer("scalar"), np.ones((5, 5), np.float32)
    scene = typed(scenes.random_scene(3), r.dtype)
    with pytest.raises(ValueError, match="colour"):
        r.forward(scene, frontal(5, 5), outputs=("colour",))
    r.forward(scene, frontal(5, 5))
    for name in ("colour", "transmittance", "hits"):  # the last two are images, but have no gradient
        with pytest.raises(ValueError, match=name):
            r.backward({name: ones})
    with pytest.raises(ValueError, match="opacity"):
        r.backward({"alpha": ones}, ("opacity",))
    with pytest.raises(ValueError, match="sse9"):
        Rasterizer("sse9")


# --- the layer that checks arguments


OTHER_PRECISION = {"float32": "f8", "float64": "f4", "int64": "i4", "uint32": "u8", "uint8": "u2"}


def wrong_versions(array: np.ndarray, writes: bool, optional: bool) -> dict[str, object]:
    """Everything an argument of this type and shape must not be."""
    other = {"f": np.int32, "i": np.float32, "u": np.int64}[array.dtype.kind]
    wide = np.zeros((*array.shape[:-1], 2 * array.shape[-1]), array.dtype)
    wrong = {
        "other type": array.astype(other),
        "other precision": array.astype(OTHER_PRECISION[array.dtype.name]),
        "swapped bytes": array.astype(array.dtype.newbyteorder()),
        "a row less": array[:-1].copy(),
        "a row more": np.concatenate([array, array[:1]]),
        "flat": array.reshape(-1) if array.ndim > 1 else array.reshape(-1, 1),
        "another axis": array[..., None],
        "strided": wide[..., ::2],
        "backwards": array[::-1],
        "scalar": array.dtype.type(0),
        "list": array.tolist(),
    }
    if array.dtype.itemsize == 1:  # one byte has no order
        del wrong["swapped bytes"]
        wrong["truth values"] = array.astype(bool)
    if array.ndim > 1:
        wrong["Fortran order"] = np.asfortranarray(array)
        wrong["transposed"] = np.ascontiguousarray(array.T)
    if writes:
        wrong["read-only"] = array.copy()
        wrong["read-only"].setflags(write=False)
    if not optional:
        wrong["nothing"] = None
    return wrong


def real(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def prepared_rasterizer() -> Rasterizer:
    r = Rasterizer("scalar")
    scene = typed(scenes.random_scene(7, 1, 1), r.dtype)
    r.forward(scene, frontal(6, 5), RenderOptions(mask_kind="svr"), outputs=IMAGES)
    return r


def call_forward(r, masks, depth_limit, **arrays):
    return r.forward(SimpleNamespace(**arrays), frontal(6, 5), masks=masks, depth_limit=depth_limit)


def call_backward(r, **weights):
    return r.backward(weights)


def call_adam(r, param, moments, grad, ids):
    return r.adam(param, moments, grad, ids, lr=0.1, step=1)


CALLS = {  # call: {argument: (a right value, written to, may be None)}
    call_forward: {
        "means": (real(7, 3), False, False),
        "log_scales": (real(7, 3), False, False),
        "quats": (real(7, 4) + 1, False, False),
        "opacity_logits": (real(7), False, False),
        "sh": (real(7, 4, 3), False, False),
        "masks": (np.ones(7, np.uint8), False, True),
        "depth_limit": (real(5, 6), False, True),
    },
    call_backward: {
        "rgb": (real(5, 6, 3), False, False),
        "depth": (real(5, 6), False, False),
        "alpha": (real(5, 6), False, False),
        "mask": (real(5, 6), False, False),
    },
    Rasterizer.add_scores: {
        "sum_": (np.zeros(7), True, True),
        "max_": (real(7), True, True),
        "hits": (np.zeros(7, np.int64), True, True),
        "transmittance": (np.zeros(7), True, True),
        "reached": (np.zeros(7, np.uint8), True, True),
        "pixels": (np.zeros((5, 6), np.uint8), False, True),
    },
    Rasterizer.loss: {"image": (real(5, 6, 3), False, False), "target": (real(5, 6, 3), False, False)},
    call_adam: {
        "param": (real(7, 3), True, False),
        "moments": (np.zeros((7, 3), np.uint32), True, False),
        "grad": (real(4, 3), False, False),
        "ids": (np.arange(4, dtype=np.uint32), False, True),
    },
}
ARGUMENTS = [(call, name) for call, arguments in CALLS.items() for name in arguments]


@pytest.mark.parametrize(("call", "name"), ARGUMENTS, ids=lambda x: getattr(x, "__name__", x))
def test_wrong_arguments_are_type_errors(call, name):
    """Wrong type, byte order, shape, strides, or read-only where the library writes; nothing is called."""
    r = prepared_rasterizer()
    right = {k: array for k, (array, _, _) in CALLS[call].items()}
    call(r, **right)
    array, writes, optional = CALLS[call][name]
    for what, wrong in wrong_versions(array, writes, optional).items():
        with pytest.raises(TypeError):
            call(r, **right | {name: wrong})
            pytest.fail(f"{name}: {what} was accepted")
    call(r, **right)


def test_wrong_logits_are_type_errors():
    for what, wrong in wrong_versions(real(7), writes=False, optional=False).items():
        if what in ("a row less", "a row more"):
            continue
        with pytest.raises(TypeError):
            sample_masks(wrong, 0, 0)
            pytest.fail(f"{what} was accepted")


@pytest.mark.parametrize("level", LEVELS)
def test_arrays_of_the_other_precision_are_type_errors(level):
    r = rasterizer(level)
    other = typed(scenes.random_scene(3), np.float32 if level == "float64" else np.float64)
    with pytest.raises(TypeError, match="float"):
        r.forward(other, frontal(5, 5))


def test_sh_of_no_degree_is_refused():
    r = rasterizer("scalar")
    for coefficients in (0, 2, 3, 5, 17):
        scene = typed(scenes.random_scene(3), r.dtype)
        scene.sh = np.zeros((3, coefficients, 3), np.float32)
        with pytest.raises((NativeError, TypeError)):
            r.forward(scene, frontal(5, 5))


def test_interface_version_is_that_of_the_library():
    assert library.library().svrgs_interface_version() == library.INTERFACE_VERSION
