"""The same bits: each gradient alone, any number of threads, depth limits, and buffers used again."""

import numpy as np
import pytest

import scenes
from native_helpers import (
    BACKGROUND,
    CAMERA,
    IMAGES,
    LEVELS,
    assert_same_bits,
    backward,
    everything,
    image_weights,
    render,
    scattered,
    typed,
)
from svrgs_addon.native import library
from svrgs_addon.native.library import GRADS
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.system.errors import NativeError

pytestmark = pytest.mark.usefixtures("default_threads")

# --- each gradient only when asked for


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "b"])
def test_each_gradient_alone_has_the_same_bits(level, kind):
    scene, masks = scenes.random_scene(60, 3, 3, scale=0.3), scenes.random_masks(60, 3)
    weights = image_weights(CAMERA)
    render(level, scene, CAMERA, masks, mask_kind=kind)
    together = backward(level, weights, 60)
    assert all(g.any() for g in together.values())
    for name in GRADS:
        assert_same_bits(backward(level, weights, 60, (name,)), {name: together[name]})
    assert backward(level, weights, 60, ()) == {}


@pytest.mark.parametrize("level", LEVELS)
def test_each_image_alone_has_the_same_bits(level):
    scene, masks = scenes.random_scene(60, 3, 3, scale=0.3), scenes.random_masks(60, 3)
    together = render(level, scene, CAMERA, masks)
    for name in IMAGES:
        assert_same_bits(render(level, scene, CAMERA, masks, (name,)), {name: together[name]})
    assert render(level, scene, CAMERA, masks, ()) == {}


@pytest.mark.parametrize("level", LEVELS)
def test_no_image_gradient_is_a_zero_gradient(level):
    scene = scenes.random_scene(30, 3, 1)
    render(level, scene, CAMERA)
    assert all(not g.any() for g in backward(level, {}, 30).values())


# --- repeatability


def dense_view(level: str) -> dict[str, np.ndarray]:
    """Several chunks of projection, binning, tiles and gradients."""
    scene = scenes.random_scene(10_000, 1, 1, scale=0.02)
    return everything(level, scene, scenes.random_masks(10_000, 1), camera=scenes.camera(100, 70, fov=75))


@pytest.mark.parametrize("level", [library.best_level(), "scalar", "float64"])
def test_same_bits_for_any_number_of_threads(level):
    library.set_threads(1)
    expected = dense_view(level)
    assert len(expected["visible"]) > 8192
    for threads in (1, 2, 3, 7, 16):
        library.set_threads(threads)
        assert library.threads() == threads
        for _ in range(2 if threads > 1 else 1):
            assert_same_bits(dense_view(level), expected)


SLOPE = np.broadcast_to(np.where(np.arange(100) < 90, np.linspace(2, 6, 100), np.inf), (70, 100))


def limited_view(level: str, limit=SLOPE, **options) -> dict[str, np.ndarray]:
    """The images of a view of several chunks a tile."""
    scene, camera = scenes.random_scene(4000, 1, 1, scale=0.1, opacity=-3.0), scenes.camera(100, 70, fov=75)
    return render(level, scene, camera, scenes.random_masks(4000, 1), depth_limit=limit, **options)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("full", [True, False])
def test_depth_limits_keep_their_bits_for_any_threads_and_skips(level, full):
    expected, whole = limited_view(level, full=full), limited_view(level, limit=None, full=full)["hits"]
    assert (expected["hits"] < whole).mean() > 0.4 and (expected["hits"] == whole)[:, 90:].all()
    for threads in (1, 3, 16):
        library.set_threads(threads)
        assert_same_bits(limited_view(level, full=full), expected)
    assert_same_bits(limited_view(level, full=full, disabled_skips=tuple(library.skips())), expected)


@pytest.mark.parametrize("level", LEVELS)
def test_a_limit_beyond_everything_changes_no_bit(level):
    scene, masks = scenes.opaque_stack(60, 2, 1), scenes.random_masks(60, 2)
    for kind, full in (("none", True), ("svr", True), ("svr", False), ("a", True)):
        whole, far = (
            render(level, scene, CAMERA, masks, mask_kind=kind, full=full, depth_limit=limit)
            for limit in (None, np.full((27, 40), np.inf))
        )
        assert_same_bits(far, whole)


def test_views_with_a_depth_limit_are_for_looking_at():
    r, scene = Rasterizer(), scenes.random_scene(20, 1, 1)
    r.forward(typed(scene, r.dtype), CAMERA, depth_limit=np.ones((27, 40), r.dtype))
    n, residuals = np.zeros(20), np.zeros((27, 40, 3), r.dtype)
    calls = (
        lambda: r.backward({"rgb": residuals}),
        lambda: r.add_scores(n, np.zeros(20, np.float32), np.zeros(20, np.int64)), r.moments,
        lambda: r.add_removal(n, residuals), lambda: r.add_slopes(n), lambda: r.add_dominance(n),
        lambda: r.work(count_pixels=True),
    )  # fmt: skip
    for call in calls:
        with pytest.raises(NativeError, match="a view with a depth limit has no gradients and no statistics"):
            call()
    r.forward(typed(scene, r.dtype), CAMERA)
    for call in calls:
        call()


@pytest.mark.parametrize("level", LEVELS)
def test_buffers_of_earlier_views_leave_no_trace(level):
    """Large, small, large again, and in a fresh renderer."""
    small, masks = scenes.random_scene(20, 2, 2, scale=0.3), scenes.random_masks(20, 2)
    options = RenderOptions(mask_kind="svr", background=BACKGROUND)
    fresh = Rasterizer(level)
    expected = fresh.forward(typed(small, fresh.dtype), CAMERA, options, masks.astype(np.uint8), IMAGES)
    grads = fresh.backward({k: w.astype(fresh.dtype) for k, w in image_weights(CAMERA).items()})
    expected |= {f"d{k}": scattered(g, fresh.visible(), 20) for k, g in grads.items()}
    for _ in range(2):
        everything(level, scenes.opaque_stack(90, 1, 3), camera=scenes.camera(70, 50))
        result = everything(level, small, masks)
        assert_same_bits({k: result[k] for k in expected}, expected)
