"""What the native tests share: one renderer per SIMD level, scenes in its type, gradients in scene order, and
checks of images."""

from __future__ import annotations

import functools
from types import SimpleNamespace

import numpy as np

import scenes
from svrgs_addon.finetune.moments import packed
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import COUNTS, IMAGES, Rasterizer, RenderOptions

LEVELS = library.supported_levels()
FLOAT_LEVELS = [level for level in LEVELS if level != "float64"]
ARRAYS = ("means", "log_scales", "quats", "opacity_logits", "sh")
FLOAT_IMAGES = tuple(IMAGES)
IMAGES = (*FLOAT_IMAGES, *COUNTS)
LOSS_IMAGES = ("rgb", "depth", "alpha", "mask")  # those a gradient may come from
BACKGROUND = (0.2, 0.5, 0.9)
CAMERA = scenes.camera(40, 27)


@functools.cache
def rasterizer(level: str) -> Rasterizer:
    return Rasterizer(level)


def typed(scene, dtype) -> SimpleNamespace:
    """Writable copies of the scene's five arrays in another type."""
    return SimpleNamespace(**{name: np.array(getattr(scene, name), dtype, order="C") for name in ARRAYS})


def some_moments(shape: tuple, rng, dtype, spread: float, step: int) -> np.ndarray:
    """Adam moments of values of that shape: random first ones, and second ones as large as their squares
    might be."""
    first, second = (
        rng.normal(0, spread, s).astype(dtype) for s in (shape, shape[:1] if len(shape) == 3 else shape)
    )
    return packed(first, np.abs(second), step)


def bytes_of(masks) -> np.ndarray | None:
    """Masks of 0.0 and 1.0 as the library takes them."""
    return None if masks is None else np.ascontiguousarray(masks, np.uint8)


def render(
    level: str, scene, camera, masks=None, outputs=IMAGES, depth_limit=None, **options
) -> dict[str, np.ndarray]:
    """One view of the scene, all images by default; the background is BACKGROUND unless given."""
    r = rasterizer(level)
    options = RenderOptions(**{"background": BACKGROUND, "mask_kind": "svr"} | options)
    limit = None if depth_limit is None else np.ascontiguousarray(depth_limit, r.dtype)
    return r.forward(typed(scene, r.dtype), camera, options, bytes_of(masks), outputs, limit)


def image_weights(camera, seed: int = 0) -> dict[str, np.ndarray]:
    """Random dL/dimage of either sign, float64, for every image of LOSS_IMAGES."""
    rng, size = np.random.default_rng(seed), (camera.height, camera.width)
    return {name: rng.normal(size=(*size, 3) if name == "rgb" else size) for name in LOSS_IMAGES}


def backward(
    level: str, weights: dict[str, np.ndarray], count: int, wanted=library.GRADS
) -> dict[str, np.ndarray]:
    """Gradients of the last view, a row per Gaussian of the scene: zero where it is not visible."""
    r = rasterizer(level)
    rows = r.backward({name: np.ascontiguousarray(w, r.dtype) for name, w in weights.items()}, wanted)
    return {name: scattered(values, r.visible(), count) for name, values in rows.items()}


def scattered(rows: np.ndarray, ids: np.ndarray, count: int) -> np.ndarray:
    full = np.zeros((count, *rows.shape[1:]), rows.dtype)
    full[ids] = rows
    return full


def view_and_gradients(level, scene, camera, masks=None, seed=0, **options):
    """Images and gradients of one view, everything asked for."""
    images = render(level, scene, camera, masks, **options)
    grads = backward(level, image_weights(camera, seed), len(scene.means))
    return images, grads


def everything(level, scene, masks=None, camera=CAMERA, **options):
    """Images, gradients of all of them, scores and visible ids of one view."""
    images = render(level, scene, camera, masks, **options)
    n = len(scene.means)
    scores = dict(sum=np.zeros(n), max=np.zeros(n, np.float32), pixels=np.zeros(n, np.int64))
    rasterizer(level).add_scores(*scores.values())
    scores |= dict(slopes=np.zeros(n), dominance=np.zeros(n))
    rasterizer(level).add_slopes(scores["slopes"])
    rasterizer(level).add_dominance(scores["dominance"])
    grads = {f"d{k}": g for k, g in backward(level, image_weights(camera), n).items()}
    return images | grads | scores | {"visible": rasterizer(level).visible().copy()}


def relative_l2(value: np.ndarray, expected: np.ndarray) -> float:
    """|value − expected| / |expected|; an expected zero demands exact zeros."""
    value, expected = np.asarray(value, np.float64), np.asarray(expected, np.float64)
    scale = np.linalg.norm(expected)
    return (
        float(np.linalg.norm(value - expected) / scale) if scale else float(np.abs(value).max(initial=0) > 0)
    )


def assert_same_bits(left: dict[str, np.ndarray], right: dict[str, np.ndarray]):
    assert left.keys() == right.keys()
    for name in left:
        assert left[name].dtype == right[name].dtype and left[name].shape == right[name].shape, name
        assert left[name].tobytes() == right[name].tobytes(), name


def assert_finite(arrays: dict[str, np.ndarray]):
    for name, array in arrays.items():
        assert np.isfinite(array).all(), name


def assert_in_range(images: dict[str, np.ndarray]):
    """What holds for any scene whose colours are not negative."""
    assert_finite(images)
    for name in ("rgb", "depth", "mask"):
        assert images[name].min() >= -1e-6, name
    for name in ("alpha", "transmittance"):
        assert images[name].min() >= 0 and images[name].max() <= 1, name
    assert (0 <= images["kept"]).all() and (images["kept"] <= images["hits"]).all()


def frontal(width: int, height: int, focal: float = 20.0):
    """A camera at the origin looking along +z, principal point in the middle."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return scenes.Camera(np.eye(4), K, width, height)


def isotropic(means, scale=0.1, opacity=0.5, dc=0.4) -> SimpleNamespace:
    """Float64 Gaussians of one size; opacity and dc (SH coefficient, grey) are one value or one for each."""
    n, opacity = len(means), np.asarray(opacity, np.float64)
    return SimpleNamespace(
        means=np.array(means, np.float64).reshape(n, 3),
        log_scales=np.full((n, 3), np.log(scale)),
        quats=np.tile([1.0, 0, 0, 0], (n, 1)),
        opacity_logits=np.broadcast_to(np.log(opacity / (1 - opacity)), n).copy(),
        sh=np.broadcast_to(np.asarray(dc, np.float64).reshape(-1, 1, 1), (n, 1, 3)).copy(),
    )
