"""Scores and visible ids of the native core, against the float64 reference."""

import functools

import numpy as np
import pytest
import torch

import scenes
from native_helpers import (
    CAMERA,
    LEVELS,
    assert_same_bits,
    backward,
    everything,
    image_weights,
    rasterizer,
    render,
)
from reference import rasterize as ref
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import NativeError


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
    sum_, max_ = np.zeros(scene.count), np.zeros(scene.count, np.float32)
    pixels = np.zeros(scene.count, np.int64)
    for camera in SCORED[name][1]:
        render(level, scene, camera, masks, full=full)
        rasterizer(level).add_scores(sum_, max_, pixels)
    np.testing.assert_allclose(sum_, weights.sum(0), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(max_, weights.max(0), rtol=1e-5, atol=1e-7)
    np.testing.assert_array_equal(pixels, (weights > 0).sum(0))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", SCORED)
def test_pictures_do_not_change_without_what_no_open_ray_hits(level, name):
    """To the bit: a Gaussian that is not blended anywhere may still stop a ray, so it counts as reached."""
    scene, masks, weights = scored(name)
    for view, camera in enumerate(SCORED[name][1]):
        reached = np.zeros(scene.count, np.uint8)
        colours = functools.partial(
            render, level, camera=camera, outputs=("rgb", "depth", "alpha"), full=False
        )
        whole = colours(scene, masks=masks)
        rasterizer(level).add_scores(reached=reached)
        few = np.flatnonzero(reached)
        assert set(few) >= set(np.flatnonzero(weights[view] > 0)) and masks[few].all()
        assert_same_bits(colours(scene.select(few), masks=masks[few]), whole)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", SCORED)
def test_rays_that_end_earlier_have_the_same_maxima_from_there_on(level, name):
    scene, masks, _ = scored(name)
    camera, stop = SCORED[name][1][0], 0.3
    views = []
    for least in (0.0, stop):
        alpha = render(level, scene, camera, masks, outputs=("alpha",), mask_kind="none", stop=least)["alpha"]
        largest, reached = np.zeros(scene.count, np.float32), np.zeros(scene.count, np.uint8)
        rasterizer(level).add_scores(max_=largest, reached=reached)
        views.append((alpha, largest, reached.sum()))
    (exact, maxima, all_reached), (shorter, largest, fewer) = views
    shown = maxima >= stop
    assert shown.any() and (fewer < all_reached or name == "open")
    np.testing.assert_array_equal(largest[shown], maxima[shown])
    assert (largest <= maxima).all() and (shorter <= exact).all() and (exact - shorter <= stop).all()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", SCORED)
@pytest.mark.parametrize("known", [False, True])  # the scores of all pixels
def test_scores_over_some_pixels_are_those_of_a_view_in_which_only_they_count(level, name, known):
    scene, masks, _ = scored(name)
    camera, rng = SCORED[name][1][0], np.random.default_rng(0)
    for share in (0.0, 0.2, 0.8):
        pixels = (rng.random((camera.height, camera.width)) < share).astype(np.uint8)
        pixels[:, camera.width // 3 : camera.width // 2] = 0  # whole tiles, too
        pixels[:, camera.width // 2 :] = share > 0
        scores = []
        for view, counting in ((camera, pixels), (camera.masked(pixels), None)):
            n = scene.count
            scores.append((np.zeros(n), np.zeros(n, np.float32), np.zeros(n, np.int64), np.zeros(n)))
            render(level, scene, view, masks, full=False)
            if known:
                rasterizer(level).add_scores(np.zeros(n))
            rasterizer(level).add_scores(*scores[-1], pixels=counting)
        for some, expected in zip(*scores, strict=True):
            np.testing.assert_array_equal(some, expected)
        assert scores[0][0].any() == bool(share)
        with pytest.raises(NativeError, match="other pixels"):  # of a camera that has some
            rasterizer(level).add_scores(*scores[-1], pixels=pixels)


@pytest.mark.parametrize("level", LEVELS)
def test_a_gaussian_that_stops_all_its_rays_is_reached_though_it_is_blended_nowhere(level):
    # T: 5e-2, 2.5e-3, 1.25e-4, then it would be below 1e-4; only the last one would not stop the rays
    alphas = np.array([0.95, 0.95, 0.95, 0.95, 0.1])
    places = np.stack([np.zeros(5), np.zeros(5), np.arange(1.0, 6.0)], 1).astype(np.float32)
    colours = np.random.default_rng(0).normal(size=(5, 1, 3)).astype(np.float32)
    logits = np.log(alphas / (1 - alphas)).astype(np.float32)
    walls = Scene(
        places, np.full((5, 3), 5, np.float32), np.tile(np.float32([1, 0, 0, 0]), (5, 1)), logits, colours
    )
    reached, pixels, outputs = np.zeros(5, np.uint8), np.zeros(5, np.int64), ("rgb", "depth", "alpha")
    whole = render(level, walls, CAMERA, outputs=outputs, full=False)
    rasterizer(level).add_scores(hits=pixels, reached=reached)
    assert reached.tolist() == [1, 1, 1, 1, 0] and (pixels > 0).tolist() == [True, True, True, False, False]
    assert_same_bits(render(level, walls.select(np.arange(4)), CAMERA, outputs=outputs, full=False), whole)
    assert (
        np.abs(
            render(level, walls.select(np.array([0, 1, 2, 4])), CAMERA, outputs=("alpha",), full=False)[
                "alpha"
            ]
            - whole["alpha"]
        ).min()
        > 5e-6
    )
    render(level, walls, CAMERA, outputs=("mask",), full=True)
    rasterizer(level).add_scores(reached=reached)
    assert reached.all(), "F counts to the end of the rays"


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
@pytest.mark.parametrize(
    "model", [lambda camera: camera, scenes.parallel], ids=["perspective", "orthographic"]
)
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
