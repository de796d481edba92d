"""Gradients and Adam step in one call: what the two calls do, to the bit."""

from __future__ import annotations

from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from native_helpers import ARRAYS, LEVELS, image_weights, rasterizer, some_moments, typed
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import RenderOptions
from svrgs_addon.system.errors import NativeError

CAMERA = scenes.camera(41, 29)
COUNT = 70
RATES = {"means": 1e-3, "log_scales": 5e-3, "quats": 1e-3, "opacity_logits": 0.05, "sh": 2e-3, "masks": 0.01}


def world(level: str, sh_degree: int, count: int = COUNT):
    """A scene with moments of an earlier step, masks, and image gradients, in the level's type."""
    dtype, rng = rasterizer(level).dtype, np.random.default_rng(3)
    scene = typed(scenes.random_scene(count, 5, sh_degree, scale=0.3), dtype)
    moments = {name: some_moments(getattr(scene, name).shape, rng, dtype, 1e-3, 6) for name in ARRAYS}
    masks = scenes.random_masks(count, 5).astype(np.uint8)
    weights = {name: np.ascontiguousarray(image_weights(CAMERA)[name], dtype) for name in ("rgb", "mask")}
    return SimpleNamespace(**vars(scene), moments=moments, masks=masks, weights=weights)


def rates_of(scene) -> dict:
    columns = np.full(scene.sh[0].size, RATES["sh"] / 20)
    columns[:3] = RATES["sh"]
    return RATES | {"sh": columns}


def render(r, scene):
    return r.forward(scene, CAMERA, RenderOptions(mask_kind="svr"), scene.masks, ("rgb", "mask"))


def in_two_calls(r, scene, frozen=None):
    render(r, scene)
    grads = r.backward(scene.weights, (*ARRAYS, "masks", "means2d"))
    rates, ids = rates_of(scene), r.visible()
    trained = np.ones(len(ids), bool) if frozen is None else frozen[ids] == 0
    grads, ids = {name: rows[trained] for name, rows in grads.items()}, ids[trained]
    bad = sum(
        r.adam(getattr(scene, name), scene.moments[name], grads[name], ids, lr=rates[name], step=7)
        for name in ARRAYS
    )
    return {name: grads[name] for name in ("masks", "means2d")}, bad


def in_one_call(r, scene, frozen=None):
    render(r, scene)
    tensors = {name: (getattr(scene, name), scene.moments[name]) for name in ARRAYS}
    return r.backward_update(
        scene.weights, tensors, rates_of(scene), step=7, frozen=frozen, wanted=("masks", "means2d")
    )


def assert_same(a, b):
    for name in ARRAYS:
        for left, right in zip(
            (getattr(a, name), a.moments[name]), (getattr(b, name), b.moments[name]), strict=True
        ):
            assert left.tobytes() == right.tobytes(), name


@pytest.mark.parametrize("sh_degree", [0, 1, 3])
@pytest.mark.parametrize("level", LEVELS)
def test_one_call_does_what_two_do(level, sh_degree):
    r, two, one = rasterizer(level), world(level, sh_degree), world(level, sh_degree)
    before = world(level, sh_degree)
    (expected, bad), (grads, bad_in_one) = in_two_calls(r, two), in_one_call(r, one)
    assert bad == bad_in_one == 0
    for name in expected:
        assert grads[name].tobytes() == expected[name].tobytes(), name
    assert_same(one, two)
    assert all((getattr(one, name) != getattr(before, name)).any() for name in ARRAYS)


@pytest.mark.parametrize("share", [0.1, 0.5, 0.95, 1.0])
@pytest.mark.parametrize("level", LEVELS)
def test_frozen_gaussians_are_blended_but_not_updated(level, share):
    r, two, one, before = rasterizer(level), world(level, 3, 600), world(level, 3, 600), world(level, 3, 600)
    frozen = (np.random.default_rng(7).random(600) < share).astype(np.uint8)
    (expected, bad), (grads, bad_in_one) = in_two_calls(r, two, frozen), in_one_call(r, one, frozen)
    assert bad == bad_in_one == 0
    for name in expected:
        assert grads[name].tobytes() == expected[name].tobytes(), name
    assert_same(one, two)
    for name in ARRAYS:
        moved = (getattr(one, name) != getattr(before, name)).reshape(600, -1).any(axis=1)
        assert not moved[frozen == 1].any() and moved.any() == (share < 1), name


def existence(r, count: int = COUNT):
    """Existence logits of so many Gaussians, their moments, and their slopes."""
    rng = np.random.default_rng(4)
    logits = rng.normal(1, 1, count).astype(r.dtype)
    return logits, some_moments(logits.shape, rng, r.dtype, 1e-3, 6), rng.random(count).astype(r.dtype)


@pytest.mark.parametrize("level", LEVELS)
def test_existence_logits_are_updated_by_the_gradient_of_their_mask_times_its_slope(level):
    r, two, one = rasterizer(level), world(level, 1), world(level, 1)
    (expected, expected_moments, slope), (found, moments, _) = existence(r), existence(r)
    d_masks = in_two_calls(r, two)[0]["masks"]
    ids = r.visible()
    r.adam(expected, expected_moments, d_masks * slope[ids], ids, lr=RATES["masks"], step=7)
    render(r, one)
    tensors = {name: (getattr(one, name), one.moments[name]) for name in ARRAYS} | {"masks": (found, moments)}
    _, bad = r.backward_update(one.weights, tensors, rates_of(one), step=7, slope=slope, wanted=("means2d",))
    assert bad == 0 and (found != existence(r)[0]).any()
    assert found.tobytes() == expected.tobytes() and moments.tobytes() == expected_moments.tobytes()
    assert_same(one, two)


def test_existence_logits_need_their_slopes():
    r, scene = rasterizer("scalar"), world("scalar", 1)
    logits, moments, slope = existence(r)
    render(r, scene)
    tensors = {"sh": (scene.sh, scene.moments["sh"]), "masks": (logits, moments)}
    with pytest.raises(TypeError, match="slope"):
        r.backward_update(scene.weights, tensors, rates_of(scene), step=1, slope=slope[:-1])
    with pytest.raises(TypeError, match="slope"):
        r.backward_update(scene.weights, tensors, rates_of(scene), step=1)
    with pytest.raises(ValueError, match="not stored: masks"):
        r.backward_update(scene.weights, tensors, rates_of(scene), step=1, slope=slope, wanted=("masks",))


@pytest.mark.parametrize("count", [16, 262, 264, 520])
def test_parameters_may_end_anywhere(count):
    """Within the whole vectors that narrow rows are updated in, and these across the blocks gradients are
    made in."""
    level = library.best_level()
    r, two, one = rasterizer(level), world(level, 1, count), world(level, 1, count)
    for scene in (two, one):
        scene.opacity_logits[:] = 3
        scene.opacity_logits[:5] = -20
    in_two_calls(r, two), in_one_call(r, one)
    assert r.visible()[-1] == count - 1
    assert_same(one, two)


@pytest.mark.parametrize("apart", [("opacity_logits",), ("log_scales",), ("means", "quats")])
def test_what_is_not_updated_has_its_gradients_instead(apart):
    r, two, one, before = (
        make(library.best_level()) for make in (rasterizer, *[lambda level: world(level, 3)] * 3)
    )
    render(r, one)
    tensors = {name: (getattr(one, name), one.moments[name]) for name in ARRAYS if name not in apart}
    grads, bad = r.backward_update(one.weights, tensors, rates_of(one), step=7, wanted=("masks", *apart))
    assert bad == 0 and all((getattr(one, name) == getattr(before, name)).all() for name in apart)
    grads, ids = {name: rows.copy() for name, rows in grads.items()}, r.visible()
    for name in apart:
        r.adam(getattr(one, name), one.moments[name], grads[name], ids, lr=rates_of(one)[name], step=7)
    expected, _ = in_two_calls(r, two)
    assert grads["masks"].tobytes() == expected["masks"].tobytes()
    assert_same(one, two)


def test_sh_is_updated_always():
    r, scene = rasterizer("scalar"), world("scalar", 1)
    render(r, scene)
    tensors = {"means": (scene.means, scene.moments["means"])}
    with pytest.raises(NativeError, match="missing"):
        r.backward_update(scene.weights, tensors, rates_of(scene), step=1, wanted=("sh",))


@pytest.mark.parametrize("level", LEVELS)
def test_rows_without_a_finite_gradient_are_left_alone_and_counted(level):
    r, two, one, before = rasterizer(level), world(level, 3), world(level, 3), world(level, 3)
    for scene in (two, one):
        scene.weights["rgb"][12, 20, 1] = np.nan
    (_, bad), (_, bad_in_one) = in_two_calls(r, two), in_one_call(r, one)
    assert bad == bad_in_one > 0
    assert_same(one, two)
    assert all(np.isfinite(getattr(one, name)).all() for name in ARRAYS)
    assert (one.means == before.means).all(axis=1).any() and (one.means != before.means).any()


def test_the_result_does_not_depend_on_the_number_of_threads():
    results = []
    try:
        for threads in (1, 2, 3, 7):
            library.set_threads(threads)
            results.append(world(library.best_level(), 3))
            in_one_call(rasterizer(library.best_level()), results[-1])
    finally:
        library.set_threads(0)
    for other in results[1:]:
        assert_same(results[0], other)


def test_a_view_is_used_up():
    r, scene = rasterizer("scalar"), world("scalar", 1)
    in_one_call(r, scene)
    with pytest.raises(NativeError, match="svrgs_forward"):
        r.backward(scene.weights, ("means",))


def test_what_is_updated_must_be_the_rendered_scene_in_shape():
    r, scene = rasterizer("scalar"), world("scalar", 1)
    render(r, scene)
    tensors = {name: (getattr(scene, name), scene.moments[name]) for name in ARRAYS}
    with pytest.raises(TypeError, match="moments of quats"):
        r.backward_update(
            scene.weights,
            tensors | {"quats": (scene.quats, scene.moments["quats"][:3])},
            rates_of(scene),
            step=1,
        )
    with pytest.raises(ValueError, match="not stored: means"):
        r.backward_update(scene.weights, tensors, rates_of(scene), step=1, wanted=("means",))
