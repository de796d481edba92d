"""What must hold between runs of the native core, whatever the numbers: absence, order, threads, skipping, scores."""

import functools
import os
import subprocess
import sys
import threading
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

import scenes
from native_helpers import (
    ARRAYS,
    BACKGROUND,
    FLOAT_IMAGES,
    IMAGES,
    LEVELS,
    assert_same_bits,
    backward,
    frontal,
    image_weights,
    isotropic,
    rasterizer,
    render,
    scattered,
    typed,
)
from reference import rasterize as ref
from svrgs_addon import native
from svrgs_addon.errors import Cancelled, NativeError
from svrgs_addon.native import GRADS, Rasterizer, RenderOptions
from svrgs_addon.scene import Scene

CAMERA = scenes.camera(40, 27)
ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(autouse=True)
def default_threads():
    yield
    native.set_threads(0)


def joined(*parts: Scene) -> Scene:
    return Scene(*(np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS))


def rgb_gradients(level, scene, masks=None, **options):
    """Images, and the gradients of the colours alone."""
    images = render(level, scene, CAMERA, masks, **options)
    return images, backward(level, {"rgb": image_weights(CAMERA)["rgb"]}, len(scene.means))


def everything(level, scene, masks=None, camera=CAMERA, **options):
    """Images, gradients of all of them, scores and visible ids of one view."""
    images = render(level, scene, camera, masks, **options)
    n = len(scene.means)
    scores = dict(sum=np.zeros(n), max=np.zeros(n, np.float32), pixels=np.zeros(n, np.int64))
    rasterizer(level).add_scores(*scores.values())
    grads = {f"d{k}": g for k, g in backward(level, image_weights(camera), n).items()}
    return images | grads | scores | {"visible": rasterizer(level).visible().copy()}


# --- absence


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("make", [scenes.random_scene, scenes.opaque_stack])
@pytest.mark.parametrize("antialiased", [False, True])
def test_masked_equals_deleted(level, make, antialiased):
    """The same bits in C, depth, alpha, T and in every other Gaussian's gradient; K too, but not N."""
    scene, masks = make(60, 8, 2), scenes.random_masks(60, 8, keep=0.5)
    kept = masks == 1
    images, grads = rgb_gradients(level, scene, masks, antialiased=antialiased)
    fewer, fewer_grads = rgb_gradients(level, scene.select(kept), antialiased=antialiased)
    for name in ("rgb", "depth", "alpha", "transmittance", "kept"):
        np.testing.assert_array_equal(images[name], fewer[name], err_msg=name)
    assert_same_bits({k: g[kept] for k, g in grads.items()}, fewer_grads)
    assert (images["hits"] > fewer["hits"]).any()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "a"])
def test_masked_out_gaussians_learn_only_whether_to_exist(level, kind):
    scene, masks = scenes.random_scene(60, 3, 1, scale=0.3), scenes.random_masks(60, 3, keep=0.5)
    result = everything(level, scene, masks, mask_kind=kind)
    absent = masks == 0
    assert result["dmasks"][absent].any() and result["dmasks"][~absent].any()
    for name in (*ARRAYS, "means2d"):
        assert not result[f"d{name}"][absent].any(), name
        assert result[f"d{name}"][~absent].any(), name
    assert not result["sum"][absent].any() and not result["max"][absent].any() and not result["pixels"][absent].any()


@pytest.mark.parametrize("level", LEVELS)
def test_all_masks_one_equals_no_masks(level):
    scene = scenes.random_scene(60, 4, 2, scale=0.3)
    assert_same_bits(everything(level, scene, np.ones(60)), everything(level, scene, None))


@pytest.mark.parametrize("level", LEVELS)
def test_culled_gaussians_change_no_bit(level):
    """Behind, too faint, aside: before, between and after the others."""
    scene, masks = scenes.random_scene(60, 5, 1, scale=0.3), scenes.random_masks(60, 5)
    behind, faint, aside = (scenes.random_scene(20, seed, 1) for seed in (6, 7, 8))
    behind.means[:, 2] = -scenes.DISTANCE + 0.2 - np.abs(behind.means[:, 2])
    faint.opacity_logits[:] = -5.6
    aside.means[:, 0] += 500
    culled = joined(behind, faint, aside)
    order = np.random.default_rng(0).permutation(120)
    order = order[np.argsort(np.where(order < 60, order, -1), kind="stable")]  # those of the scene keep their order
    slots = np.random.default_rng(1).permutation(120) < 60
    index = np.empty(120, int)
    index[slots], index[~slots] = np.arange(60), order[:60]
    mixed, mixed_masks = joined(scene, culled).select(index), np.concatenate([masks, np.ones(60)])[index]

    alone, together = everything(level, scene, masks), everything(level, mixed, mixed_masks)
    visible = np.flatnonzero(slots)[alone.pop("visible")]
    np.testing.assert_array_equal(together.pop("visible"), visible)
    for name in alone.keys() - set(IMAGES):
        assert not together[name][~slots].any(), name
        together[name] = together[name][slots]
    assert_same_bits(together, alone)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", native.mask_kinds())
def test_nothing_to_draw_is_the_background(level, kind):
    behind, faint = scenes.random_scene(30, 1, 1), scenes.random_scene(30, 2, 1)
    behind.means[:, 2] = -10
    faint.opacity_logits[:] = -8
    for scene in (scenes.empty_scene(), behind, faint):
        result = everything(level, scene, mask_kind=kind)
        background = np.array(BACKGROUND, rasterizer(level).dtype)
        np.testing.assert_array_equal(result["rgb"], np.broadcast_to(background, (27, 40, 3)))
        assert (result["transmittance"] == 1).all() and rasterizer(level).work()["pairs"] == 0
        for name in result.keys() - {"rgb", "transmittance"}:
            assert not result[name].any(), name


# --- identities of one view


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("full", [True, False])
def test_mask_is_its_closed_form(level, full):
    scene, masks = scenes.opaque_stack(40, 5, 0), scenes.random_masks(40, 5)
    image = render(level, scene, CAMERA, masks, full=full)
    N, K, T = (image[name].astype(np.float64) for name in ("hits", "kept", "transmittance"))
    np.testing.assert_allclose(image["mask"], (K - 1 + T) / np.log1p(N), rtol=3e-7 if level != "float64" else 1e-15)
    assert N.min() > 0 and (K < N).any()


@pytest.mark.parametrize("level", LEVELS)
def test_mask_gradient_lies_in_its_range(level):
    """0 < dF/dM ≤ 1 / log(1 + N) at one pixel, and 0 for what does not hit it."""
    scene, masks, camera = scenes.opaque_stack(30, 6, 0), scenes.random_masks(30, 6), scenes.camera(1, 1)
    image = render(level, scene, camera, masks)
    gradient = backward(level, {"mask": np.ones((1, 1))}, 30, ("masks",))["masks"]
    assert 5 < np.count_nonzero(gradient) == image["hits"].item()
    assert gradient.min() >= 0 and gradient.max() <= np.float32(1 / np.log1p(image["hits"].item())) * (1 + 1e-7)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("make", [scenes.random_scene, scenes.opaque_stack])
def test_weights_and_remaining_transmittance_sum_to_one(level, make):
    """Over a whole image: the scores' sum of alpha T against the T that is left, which stops with the colours."""
    scene, masks = make(80, 6, 1), scenes.random_masks(80, 6)
    result = everything(level, scene, masks, full=False)
    pixels = CAMERA.width * CAMERA.height
    assert result["sum"].sum() + result["transmittance"].sum(dtype=np.float64) == pytest.approx(pixels, rel=1e-6)
    np.testing.assert_allclose(result["alpha"] + result["transmittance"], 1, rtol=0, atol=6e-8)


@pytest.mark.parametrize("level", LEVELS)
def test_full_and_visible_differ_in_the_mask_only(level):
    scene, masks = scenes.opaque_stack(40, 7, 0), scenes.random_masks(40, 7)
    full, visible = (render(level, scene, CAMERA, masks, full=full) for full in (True, False))
    assert_same_bits(*({k: i[k] for k in ("rgb", "depth", "alpha")} for i in (full, visible)))
    stopped = full["hits"] > visible["hits"]
    assert stopped.mean() > 0.5 and (full["hits"] >= visible["hits"]).all() and (full["kept"] >= visible["kept"]).all()
    assert (full["transmittance"][stopped] < 1e-4).all() and (visible["transmittance"] >= 1e-4).all()
    thin = scenes.random_scene(40, 7, 0, opacity=-1.0)
    modes = [everything(level, thin, masks, full=full) for full in (True, False)]
    assert modes[0]["transmittance"].min() > 1e-3  # nothing stops, so the modes agree
    assert_same_bits(*modes)


@pytest.mark.parametrize("level", LEVELS)
def test_mask_kind_changes_no_colour(level):
    scene, masks = scenes.opaque_stack(40, 8, 1), scenes.random_masks(40, 8)
    plain, plain_grads = rgb_gradients(level, scene, masks, mask_kind="none")
    assert not plain["mask"].any()
    for kind in ("svr", "self", "a", "b"):
        images, grads = rgb_gradients(level, scene, masks, mask_kind=kind)
        assert_same_bits(*({k: i[k] for k in ("rgb", "depth", "alpha")} for i in (images, plain)))
        assert_same_bits(grads, plain_grads)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "self", "a", "b", "even"])
def test_the_spatial_mask_reaches_the_masks_only(level, kind):
    scene, masks = scenes.random_scene(40, 9, 1, scale=0.3), scenes.random_masks(40, 9)
    render(level, scene, CAMERA, masks, mask_kind=kind)
    grads = backward(level, {"mask": image_weights(CAMERA)["mask"]}, 40)
    assert {name for name, gradient in grads.items() if gradient.any()} == {"masks"}


@pytest.mark.parametrize("level", LEVELS)
def test_gradients_are_linear_in_the_image_gradients(level):
    """Four images at once equal the sum of one at a time."""
    scene, masks, weights = scenes.random_scene(40, 9, 1, scale=0.3), scenes.random_masks(40, 9), image_weights(CAMERA)
    render(level, scene, CAMERA, masks)
    together = backward(level, weights, 40)
    parts = [backward(level, {name: w}, 40) for name, w in weights.items()]
    for name, gradient in together.items():
        total = sum(part[name].astype(np.float64) for part in parts)
        scale = max(np.abs(part[name]).max() for part in parts)
        np.testing.assert_allclose(gradient, total, atol=(1e-5 if level != "float64" else 1e-13) * scale, err_msg=name)


@pytest.mark.parametrize("level", LEVELS)
def test_parallel_rays_show_the_same_from_any_distance(level):
    """A step of 8 along the camera's axis: other depths, and not a colour else; no gradient pulls along the axis."""
    scene, camera = scenes.random_scene(80, 3, 2, scale=0.3), scenes.ORTHOGRAPHIC["parallel_plain"]
    back = replace(camera, viewmat=camera.viewmat + np.outer((0, 0, 1, 0), (0, 0, 0, 8)))
    near, far = render(level, scene, camera, full=False), render(level, scene, back, full=False)
    close = {"rtol": 0, "atol": 2e-6 if level != "float64" else 1e-13}
    np.testing.assert_allclose(far["rgb"], near["rgb"], **close)
    np.testing.assert_allclose(far["depth"], near["depth"] + 8 * near["alpha"], rtol=1e-5)
    grads = backward(level, {name: image_weights(camera)[name] for name in ("rgb", "alpha")}, 80)
    assert not grads["means"][:, 2].any() and grads["means"][:, :2].any()
    fx, fy = camera.K.diagonal()[:2]
    pulled = grads["means2d"] * (fx, fy)
    np.testing.assert_allclose(grads["means"][:, :2], pulled, rtol=1e-5, atol=1e-6 * np.abs(pulled).max())


# --- order


@pytest.mark.parametrize("level", LEVELS)
def test_permutation_permutes(level):
    scene, masks = scenes.random_scene(80, 9, 1, scale=0.3), scenes.random_masks(80, 9)
    assert len(np.unique(scene.means[:, 2])) == 80
    order = np.random.default_rng(9).permutation(80)
    plain, shuffled = everything(level, scene, masks), everything(level, scene.select(order), masks[order])
    np.testing.assert_array_equal(np.sort(order[shuffled.pop("visible")]), plain.pop("visible"))
    for name in plain.keys() - set(IMAGES):
        plain[name] = plain[name][order]
    assert_same_bits(plain, shuffled)


@pytest.mark.parametrize("level", LEVELS)
def test_equal_depths_keep_index_order(level):
    """Red and blue at one depth: the one with the lower index is in front."""
    for first, second in ((0, 2), (2, 0)):
        scene = isotropic([(0, 0, 2)] * 2, opacity=0.6, dc=-0.5 / 0.28209479177387814)
        scene.sh[0, 0, first] = scene.sh[1, 0, second] = 0.5 / 0.28209479177387814
        image = render(level, scene, frontal(1, 1), background=(0, 0, 0))["rgb"][0, 0]
        np.testing.assert_allclose(image[[first, second]], [0.6, 0.24], rtol=1e-6)


@pytest.mark.parametrize("level", LEVELS)
def test_many_equal_depths_are_those_of_the_reference(level):
    scene, masks = scenes.equal_depths(60, 2, 0), scenes.random_masks(60, 2)
    image = render(level, scene, CAMERA, masks)
    expected = scenes.reference_render(scenes.leaves(scene, requires_grad=False), masks, CAMERA, BACKGROUND)
    np.testing.assert_allclose(image["rgb"], expected.rgb, atol=1e-6)


# --- each gradient only when asked for


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "b"])
def test_each_gradient_alone_has_the_same_bits(level, kind):
    scene, masks, weights = scenes.random_scene(60, 3, 3, scale=0.3), scenes.random_masks(60, 3), image_weights(CAMERA)
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


@pytest.mark.parametrize("level", [native.best_level(), "scalar", "float64"])
def test_same_bits_for_any_number_of_threads(level):
    native.set_threads(1)
    expected = dense_view(level)
    assert len(expected["visible"]) > 8192
    for threads in (1, 2, 3, 7, 16):
        native.set_threads(threads)
        assert native.threads() == threads
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
        native.set_threads(threads)
        assert_same_bits(limited_view(level, full=full), expected)
    assert_same_bits(limited_view(level, full=full, disabled_skips=tuple(native.skips())), expected)


@pytest.mark.parametrize("level", LEVELS)
def test_a_limit_beyond_everything_changes_no_bit(level):
    scene, masks = scenes.opaque_stack(60, 2, 1), scenes.random_masks(60, 2)
    for kind, full in (("none", True), ("svr", True), ("svr", False), ("a", True)):
        whole, far = (render(level, scene, CAMERA, masks, mask_kind=kind, full=full, depth_limit=limit) for limit in (None, np.full((27, 40), np.inf)))
        assert_same_bits(far, whole)


def test_views_with_a_depth_limit_are_for_looking_at():
    r, scene = Rasterizer(), scenes.random_scene(20, 1, 1)
    r.forward(typed(scene, r.dtype), CAMERA, depth_limit=np.ones((27, 40), r.dtype))
    n, residuals = np.zeros(20), np.zeros((27, 40, 3), r.dtype)
    calls = (
        lambda: r.backward({"rgb": residuals}), lambda: r.add_scores(n, np.zeros(20, np.float32), np.zeros(20, np.int64)), r.moments,
        lambda: r.add_removal(n, residuals), lambda: r.work(count_pixels=True),
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


# --- scores and visible ids


def reference_weights(scene, masks, camera) -> np.ndarray:
    """M α T of every Gaussian (N) at every pixel (P) where it was blended, (P, N)."""
    p = scenes.leaves(scene, requires_grad=False)
    splats = ref.project(
        *p.values(), torch.tensor(camera.viewmat), torch.tensor(camera.K), camera.width, camera.height,
        scene.sh_degree, scene.antialiased, camera.orthographic,
    )  # fmt: skip
    alpha, _ = ref.alphas(splats, ref.pixel_centres(camera.width, camera.height))
    M = torch.as_tensor(masks, dtype=torch.float64)[splats.index]
    T = ref.transmittance(alpha, M)
    blended = torch.cumprod((T[:, 1:] >= ref.T_MIN).long(), 1).bool()
    weights = np.zeros((len(alpha), scene.count))
    weights[:, splats.index] = torch.where(blended, M * alpha * T[:, :-1], 0.0)
    return weights


SCORED = {
    "open": (scenes.random_scene(60, 4, 0), [CAMERA, scenes.camera(18, 35, eye=(1, -1, -3.5))]),
    "stopping": (scenes.opaque_stack(24, 4, 0), [scenes.camera(5, 4)] * 2),
}


@functools.cache
def scored(name: str):
    """Scene and masks away from every threshold of the views, and what the scores must be."""
    scene, cameras = SCORED[name]
    masks = scenes.random_masks(scene.count, 4)
    for camera in cameras:
        rounds = 300 if name == "stopping" else 0
        scene, masks = scenes.away_from_thresholds(scene, camera, masks, rounds=rounds)
    weights = np.concatenate([reference_weights(scene, masks, camera) for camera in cameras])
    assert len(set((weights > 0).sum(0))) > 5  # many different footprints
    return scene, masks, weights


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", SCORED)
@pytest.mark.parametrize("full", [True, False])
def test_scores_add_up_over_views(level, name, full):
    scene, masks, weights = scored(name)
    sum_, max_, pixels = np.zeros(scene.count), np.zeros(scene.count, np.float32), np.zeros(scene.count, np.int64)
    for camera in SCORED[name][1]:
        render(level, scene, camera, masks, full=full)
        rasterizer(level).add_scores(sum_, max_, pixels)
    np.testing.assert_allclose(sum_, weights.sum(0), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(max_, weights.max(0), rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(pixels, (weights > 0).sum(0))


@pytest.mark.parametrize("level", LEVELS)
def test_scores_and_gradients_do_not_disturb_each_other(level):
    scene = scenes.random_scene(60, 4, 1, scale=0.3)
    scores = np.zeros(60), np.zeros(60, np.float32), np.zeros(60, np.int64)
    render(level, scene, CAMERA)
    grads = {f"d{k}": g for k, g in backward(level, image_weights(CAMERA), 60).items()}
    rasterizer(level).add_scores(*scores)
    expected = everything(level, scene)  # scores first
    result = grads | dict(zip(("sum", "max", "pixels"), scores, strict=True))
    assert_same_bits(result, {k: expected[k] for k in result})


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("model", [lambda camera: camera, scenes.parallel], ids=["perspective", "orthographic"])
def test_visible_are_ascending_and_hold_every_hit(level, model):
    scene, masks = scenes.random_scene(300, 4, 0, scale=0.05), scenes.random_masks(300, 4)
    camera = model(scenes.camera(40, 27, fov=25))
    render(level, scene, camera, np.ones(300))
    visible = rasterizer(level).visible()
    hit = reference_weights(scene, np.ones(300), camera).any(0)
    assert (np.diff(visible.astype(np.int64)) > 0).all() and visible.dtype == np.uint32
    assert set(np.flatnonzero(hit)) <= set(visible) and len(visible) < 300
    assert len(visible) < 1.3 * hit.sum()  # little more than what hits
    expected = visible.copy()
    render(level, scene, camera, masks)
    np.testing.assert_array_equal(rasterizer(level).visible(), expected)  # masked out, yet visible


# --- cancelling


def test_cancel_stops_every_call_and_the_next_one_works():
    r, scene = Rasterizer(), scenes.random_scene(50, 1, 1)
    arrays, options = typed(scene, r.dtype), RenderOptions(mask_kind="svr")
    expected = r.forward(arrays, CAMERA, options, outputs=FLOAT_IMAGES)
    ones, scores = np.ones((27, 40), r.dtype), (np.zeros(50), np.zeros(50, np.float32), np.zeros(50, np.int64))
    gradient = r.backward({"alpha": ones}, ("masks",))["masks"].copy()
    r.cancel[0] = 1
    for call in (
        lambda: r.backward({"alpha": ones}, ("masks",)),
        lambda: r.add_scores(*scores),
        lambda: r.forward(arrays, CAMERA, options),
    ):
        with pytest.raises(Cancelled):
            call()
    assert not any(s.any() for s in scores)
    with pytest.raises(NativeError, match="forward"):  # the cancelled view is not there
        r.backward({"alpha": ones}, ("masks",))
    r.cancel[0] = 0
    assert_same_bits(r.forward(arrays, CAMERA, options, outputs=FLOAT_IMAGES), expected)
    assert r.backward({"alpha": ones}, ("masks",))["masks"].tobytes() == gradient.tobytes()


def test_cancel_from_another_thread():
    r, scene = Rasterizer(), scenes.random_scene(2000, 1, 1)
    arrays, camera = typed(scene, r.dtype), scenes.camera(300, 200)
    threading.Timer(0.05, r.cancel.fill, (1,)).start()
    deadline = time.monotonic() + 20
    with pytest.raises(Cancelled):
        while time.monotonic() < deadline:
            r.forward(arrays, camera)


def test_renderers_work_side_by_side():
    """One per Python thread; the pool is shared."""
    jobs = [(scenes.random_scene(500, seed, 1), Rasterizer()) for seed in range(4)]
    views = [(typed(scene, r.dtype), r) for scene, r in jobs]
    expected = [r.forward(arrays, CAMERA)["rgb"].tobytes() for arrays, r in views]
    got = [[] for _ in jobs]

    def work(k: int):
        arrays, r = views[k]
        got[k] = [r.forward(arrays, CAMERA)["rgb"].tobytes() for _ in range(20)]

    workers = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert all(set(images) == {expected[k]} for k, images in enumerate(got))


@pytest.mark.skipif("LD_PRELOAD" in os.environ, reason="a sanitizer needs the address space for itself")
def test_fewer_threads_where_the_system_gives_no_more():
    """In a process of its own whose address space holds few stacks."""
    code = (
        "import resource\nfrom svrgs_addon import native\nnative.threads()\n"
        "resource.setrlimit(resource.RLIMIT_AS, (2 << 30, 2 << 30))\nnative.set_threads(4000)\nassert 1 <= native.threads() < 4000, native.threads()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
