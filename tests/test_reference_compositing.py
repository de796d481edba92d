"""The reference composites as a literal walk along the ray does, and keeps its symmetries."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from reference import rasterize as ref
from reference_renders import BACKGROUND, IMAGES, frontal, gaussians, images, weighted_sum


def walk(alpha, hit, M, colour, z, mode, kind, eps) -> dict[str, object]:
    """One pixel, one splat at a time, as the text of the method says it."""
    T = T_full = 1.0
    C, depth, A, stopped, counted = np.zeros(3), 0.0, 0.0, False, []
    for i in np.flatnonzero(hit):
        if not stopped and T * (1 - M[i] * alpha[i]) < 1e-4:
            stopped = True
        if not stopped:
            C, depth, A = (
                total + M[i] * alpha[i] * T * x for total, x in ((C, colour[i]), (depth, z[i]), (A, 1))
            )
            T *= 1 - M[i] * alpha[i]
        if mode == "full" or not stopped:
            counted.append((alpha[i], M[i], T_full))
            T_full *= 1 - M[i] * alpha[i]
    N, K = len(counted), sum(m for _, m, _ in counted)
    terms = {
        "svr": lambda: sum(m * (1 - a * t) for a, m, t in counted) / math.log(1 + N),
        "b": lambda: sum(m * (1 - t) for _, m, t in counted) / math.log(1 + N),
        "a": lambda: (
            sum(m / (a * t + eps) for a, m, t in counted) / sum(1 / (a * t + eps) for a, _, t in counted)
        ),
    }
    F = terms[kind]() if N else 0.0
    rgb = C + T * np.array(BACKGROUND)
    return dict(zip(IMAGES, (rgb, depth, A, F, N, K, T, T_full), strict=True))


@pytest.mark.parametrize("mode", ["full", "visible"])
@pytest.mark.parametrize("kind", ["svr", "a", "b"])
def test_compositing_is_the_literal_walk(mode, kind):
    scene, camera = scenes.opaque_stack(30, 2, 1), scenes.camera(6, 5)
    params, masks = scenes.leaves(scene, requires_grad=False), scenes.random_masks(30, 2)
    image = images(params, masks, camera, mode=mode, mask_kind=kind, eps_a=1e-2)
    splats = ref.project(
        *params.values(), torch.tensor(camera.viewmat), torch.tensor(camera.K), 6, 5, 1, False
    )
    alpha, hit = ref.alphas(splats, ref.pixel_centres(6, 5))
    for p in range(30):
        expected = walk(
            alpha[p].numpy(), hit[p].numpy(), masks[splats.index], splats.colour.numpy(), splats.z.numpy(),
            mode, kind, 1e-2,
        )  # fmt: skip
        for name in IMAGES:
            np.testing.assert_allclose(image[name][p // 6, p % 6], expected[name], rtol=1e-12, err_msg=name)


def test_full_and_visible_differ_behind_the_stop_only():
    """α = 0.8: T = 0.2, …, 3.2e-4 after five splats; the sixth stops. One masked-out hit in front of it, one
    behind."""
    params = gaussians([(0, 0, z) for z in range(2, 14)], scale=50, opacity=0.8)
    masks = np.ones(12)
    masks[[1, 9]] = 0
    full, visible = (images(params, masks, frontal(1, 1), mode=m) for m in ("full", "visible"))
    for name in ("rgb", "depth", "alpha", "T_final"):
        np.testing.assert_array_equal(full[name], visible[name])
    assert full["T_final"].item() == pytest.approx(0.2**5, rel=1e-6)
    assert (full["N"].item(), full["K"].item()) == (12, 10)
    assert (visible["N"].item(), visible["K"].item()) == (6, 5)
    assert full["T_full"].item() == pytest.approx(0.2**10, rel=1e-6)
    assert visible["T_full"] == visible["T_final"]
    assert full["F"].item() == pytest.approx((10 - 1 + 0.2**10) / math.log(13), rel=1e-6)
    assert visible["F"].item() == pytest.approx((5 - 1 + 0.2**5) / math.log(7), rel=1e-6)


@pytest.mark.parametrize("camera", scenes.CAMERAS)
def test_mask_agrees_with_its_closed_form(camera):
    scene = scenes.random_scene(60, 5, 1, scale=0.3, opacity=2.0)
    image = images(scenes.leaves(scene), scenes.random_masks(60, 5), scenes.CAMERAS[camera])
    N, K, T = image["N"], image["K"], image["T_full"]
    closed = np.where(N > 0, (K - 1 + T) / np.log1p(np.maximum(N, 1)), 0)
    np.testing.assert_allclose(image["F"], closed, atol=1e-13)


def test_weights_and_remaining_transmittance_sum_to_one():
    scene = scenes.random_scene(60, 6, 1, scale=0.3)
    image = images(scenes.leaves(scene), scenes.random_masks(60, 6), scenes.camera(20, 15))
    np.testing.assert_allclose(image["alpha"] + image["T_final"], 1, atol=1e-14)


def test_masked_equals_deleted():
    scene, camera = scenes.random_scene(40, 8, 2, scale=0.3), scenes.camera(16, 12)
    masks = scenes.random_masks(40, 8, keep=0.5)
    kept = masks == 1
    both = scenes.leaves(scene), scenes.leaves(scene.select(kept))
    M = masks, masks[kept]
    renders = [scenes.reference_render(p, m, camera, BACKGROUND) for p, m in zip(both, M, strict=True)]
    for name in ("rgb", "depth", "alpha", "K", "T_final", "T_full"):
        np.testing.assert_allclose(*(getattr(r, name).detach() for r in renders), atol=1e-14, err_msg=name)
    for render in renders:
        weighted_sum(replace(render, F=render.F.detach())).backward()
    for name in both[0]:
        np.testing.assert_allclose(
            both[0][name].grad[kept], both[1][name].grad, rtol=1e-9, atol=1e-13, err_msg=name
        )


def test_permutation_changes_nothing():
    scene, camera = scenes.random_scene(50, 9, 1, scale=0.3), scenes.CAMERAS["rotated"]
    masks, order = scenes.random_masks(50, 9), np.random.default_rng(9).permutation(50)
    both = scenes.leaves(scene), scenes.leaves(scene.select(order))
    M = [torch.tensor(m, dtype=torch.float64, requires_grad=True) for m in (masks, masks[order])]
    renders = [scenes.reference_render(p, m, camera, BACKGROUND) for p, m in zip(both, M, strict=True)]
    for name in IMAGES:
        np.testing.assert_allclose(*(getattr(r, name).detach() for r in renders), atol=1e-14, err_msg=name)
    for render in renders:
        weighted_sum(render).backward()
    np.testing.assert_allclose(M[0].grad[order], M[1].grad, atol=1e-14)
    for name in both[0]:
        np.testing.assert_allclose(
            both[0][name].grad[order], both[1][name].grad, rtol=1e-9, atol=1e-13, err_msg=name
        )


def test_equal_depths_keep_index_order():
    params = gaussians([(0, 0, 2), (0, 0, 1), (0, 0, 2)], opacity=0.6)
    dc = torch.zeros(3, 1, 3, dtype=torch.float64)
    dc[torch.arange(3), 0, torch.arange(3)] = 1.0
    image = images(params | {"sh": dc}, [1, 0, 1], frontal(1, 1))
    front, back = 0.6, 0.4 * 0.6
    red_over_blue = (front - back) * 0.28209479177387814 + (0.2 - 0.9) * 0.16
    assert image["rgb"][0, 0, 0] - image["rgb"][0, 0, 2] == pytest.approx(red_over_blue, abs=1e-12)


def test_near_plane():
    at, beyond = (images(gaussians([(0, 0, z)]), [1], frontal(1, 1)) for z in (0.2, 0.2000001))
    assert at["N"] == 0 and beyond["N"] == 1


def test_nothing_to_draw_is_the_background():
    for params in (
        scenes.leaves(scenes.empty_scene()),
        gaussians([(0, 0, -1)]),
        gaussians([(0, 0, 2)], opacity=1e-3),
    ):
        masks = torch.ones(len(params["means"]), dtype=torch.float64, requires_grad=True)
        render = scenes.reference_render(params, masks, frontal(3, 2), BACKGROUND)
        np.testing.assert_array_equal(render.rgb.detach(), np.broadcast_to(BACKGROUND, (2, 3, 3)))
        assert not render.F.any() and not render.N.any() and (render.T_full == 1).all()
        weighted_sum(render).backward()
        assert not masks.grad.any() and all(x.grad is None or not x.grad.any() for x in params.values())


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (5, 1)])
def test_thin_images_are_pieces_of_larger_ones(size):
    """A crop is the same camera with its principal point moved, as long as no Jacobian is clamped in
    either."""
    (w, h), (x, y) = size, (4, 3)
    whole = scenes.camera(9, 9)
    K = whole.K.copy()
    K[:2, 2] -= x, y
    crop = replace(whole, K=K, width=w, height=h)
    scene = scenes.random_scene(60, 4, 1, spread=0.3, scale=0.3)
    slopes = scene.means[:, :2] / (scene.means[:, 2:] + scenes.DISTANCE)
    low, high = (limit.numpy() for limit in ref.frustum_limits(torch.tensor(K), w, h))
    scene = scene.select(((slopes > low) & (slopes < high)).all(1))
    assert scene.count >= 10
    piece, image = (images(scenes.leaves(scene), np.ones(scene.count), c) for c in (crop, whole))
    for name in IMAGES:
        np.testing.assert_allclose(piece[name], image[name][y : y + h, x : x + w], atol=1e-12, err_msg=name)


@pytest.mark.parametrize("kind", scenes.HOSTILE_SCENES)
def test_hostile_scenes_stay_finite(kind):
    scene, masks = scenes.HOSTILE_SCENES[kind](40, 1, 1), scenes.random_masks(40, 1)
    params = scenes.leaves(scene)
    for name in ("plain", "off_centre", "inside", "pixel"):
        render = scenes.reference_render(
            params, masks, scenes.CAMERAS[name], BACKGROUND, antialiased=name == "plain"
        )
        weighted_sum(render).backward()
        assert all(torch.isfinite(getattr(render, image)).all() for image in IMAGES)
    assert all(torch.isfinite(x.grad).all() for x in params.values())
