"""The reference rasterizer and loss against hand values, literal loops, finite differences and symmetries."""

import math
from dataclasses import fields, replace

import numpy as np
import pytest
import torch

import scenes
from reference import loss
from reference import rasterize as ref
from reference.gradients import central_difference
from svrgs_addon.camera import Camera

BACKGROUND = (0.2, 0.5, 0.9)
IMAGES = [f.name for f in fields(ref.Render)]


def frontal(width: int, height: int, focal: float = 20.0) -> Camera:
    """A camera at the origin looking along +z, principal point in the middle."""
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1.0]])
    return Camera(np.eye(4), K, width, height)


def gaussians(means, scale=0.1, opacity=0.5, dc=0.4) -> dict[str, torch.Tensor]:
    """Isotropic Gaussians of one opacity and grey SH coefficient, as float64 leaves."""
    n = len(means)
    arrays = {
        "means": np.asarray(means, dtype=float),
        "log_scales": np.full((n, 3), math.log(scale)),
        "quats": np.tile([1.0, 0, 0, 0], (n, 1)),
        "opacity_logits": np.full(n, math.log(opacity / (1 - opacity))),
        "sh": np.full((n, 1, 3), dc),
    }
    return {k: torch.tensor(v, requires_grad=True) for k, v in arrays.items()}


def images(params, masks, camera, **options) -> dict[str, np.ndarray]:
    """Every image of a render, as arrays."""
    render = scenes.reference_render(params, masks, camera, BACKGROUND, **options)
    return {name: getattr(render, name).detach().numpy() for name in IMAGES}


def weighted_sum(render: ref.Render, seed: int = 0) -> torch.Tensor:
    """A scalar that reads every differentiable image with random weights of either sign."""
    rng = torch.Generator().manual_seed(seed)
    parts = (render.rgb, 0.1 * render.depth, render.alpha, render.F)
    return sum((image * torch.randn(image.shape, generator=rng, dtype=torch.float64)).mean() for image in parts)


# --- gradients


CASES = {
    "plain": (scenes.random_scene(6, 1, 3, scale=0.3), scenes.camera(9, 7), {}),
    "antialiased": (
        scenes.random_scene(8, 2, 0, scale=0.2, antialiased=True),
        scenes.CAMERAS["rotated"].resized(10, 8),
        {"mask_kind": "b"},
    ),
    "scenario_a": (scenes.random_scene(8, 3, 0, scale=0.3), scenes.camera(7, 9, shift=(0.4, -0.3)), {"mask_kind": "a"}),
    "stopping": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"mode": "full"}),
    "stopping_visible": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"mode": "visible"}),
    "clamped": (scenes.off_screen(8, 5, 0), scenes.camera(6, 8), {}),
    "orthographic": (scenes.random_scene(6, 6, 3, scale=0.3), scenes.parallel(scenes.CAMERAS["rotated"].resized(9, 7)), {}),
}


def prepared(case: str):
    """Scene, masks, camera and options of a case, away from every threshold."""
    scene, camera, options = CASES[case]
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(scene.count, 7))
    assert scene.count >= 6 and 0 < masks.sum() < len(masks)
    return scene, masks, camera, options | {"antialiased": scene.antialiased}


@pytest.mark.parametrize("case", CASES)
def test_every_gradient_is_the_finite_difference(case):
    scene, masks, camera, options = prepared(case)
    params = scenes.leaves(scene) | {"masks": torch.tensor(masks, dtype=torch.float64, requires_grad=True)}

    def value(params: dict[str, torch.Tensor]) -> torch.Tensor:
        arrays = {name: x for name, x in params.items() if name != "masks"}
        return weighted_sum(scenes.reference_render(arrays, params["masks"], camera, BACKGROUND, **options))

    value(params).backward()
    for name, x in params.items():
        difference = central_difference(lambda y, name=name: value(params | {name: y}), x)
        assert difference.abs().max() > 1e-4, name
        # worst seen: 3.4e-10, a quarter of the bound, in the stopping cases
        torch.testing.assert_close(x.grad, difference, rtol=1e-6, atol=1e-9, msg=name)


def test_stopping_case_does_stop():
    scene, masks, camera, _ = prepared("stopping")
    image = images(scenes.leaves(scene), masks, camera)
    assert (image["T_full"] < image["T_final"]).mean() > 0.2


def test_clamped_scene_does_clamp():
    scene, camera, _ = CASES["clamped"]
    means_c = scene.means @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    limits = ref.frustum_limits(torch.tensor(camera.K), camera.width, camera.height)
    slopes = (means_c[:, :2] / means_c[:, 2:])[means_c[:, 2] > ref.NEAR]
    assert ((slopes < limits[0].numpy()) | (slopes > limits[1].numpy())).any(0).all()


def test_masked_out_gaussians_learn_only_whether_to_exist():
    scene = scenes.random_scene(30, 3, 1, scale=0.3)
    params, masks = scenes.leaves(scene), scenes.random_masks(30, 3, keep=0.5)
    M = torch.tensor(masks, dtype=torch.float64, requires_grad=True)
    weighted_sum(scenes.reference_render(params, M, scenes.camera(16, 12), BACKGROUND)).backward()
    assert (M.grad[masks == 0] != 0).any()
    for name, x in params.items():
        assert not x.grad[masks == 0].any(), name
        assert x.grad[masks == 1].any(), name


def test_clamped_alpha_passes_gradient_to_the_mask_only():
    params = gaussians([(0, 0, 2)], opacity=0.999)
    M = torch.ones(1, dtype=torch.float64, requires_grad=True)
    render = scenes.reference_render(params, M, frontal(1, 1), BACKGROUND)
    (render.rgb.sum() + render.F.sum()).backward()
    assert render.alpha.item() == pytest.approx(0.99, abs=1e-15)
    assert params["opacity_logits"].grad.item() == 0 and M.grad.item() != 0


# --- one Gaussian by hand


@pytest.mark.parametrize("antialiased", [False, True])
def test_isotropic_gaussian_by_hand(antialiased):
    """Focal 20, depth 2, σ 0.1: one px², plus the blur 1.3 px²; the pixel (6, 4) is (2, 1) px from the centre."""
    params = gaussians([(0, 0, 2)], scale=0.1, opacity=0.5, dc=0.4)
    image = images(params, [1], frontal(9, 7), antialiased=antialiased)
    alpha = (0.5 / 1.3 if antialiased else 0.5) * math.exp(-0.5 * (2**2 + 1**2) / 1.3)
    colour = 0.5 + 0.28209479177387814 * 0.4
    pixel = {name: value[4, 6] for name, value in image.items()}
    np.testing.assert_allclose(pixel["rgb"], alpha * colour + (1 - alpha) * np.array(BACKGROUND), rtol=1e-14)
    np.testing.assert_allclose([pixel["alpha"], pixel["depth"]], [alpha, 2 * alpha], rtol=1e-14)
    np.testing.assert_allclose(pixel["F"], (1 - alpha) / math.log(2), rtol=1e-14)
    assert pixel["T_final"] == pixel["T_full"] == pytest.approx(1 - alpha, abs=1e-15)
    assert pixel["N"] == pixel["K"] == 1
    far = {name: value[0, 0] for name, value in image.items()}  # (−4, −3) px: below 1/255
    assert far["N"] == far["F"] == far["alpha"] == 0
    np.testing.assert_array_equal(far["rgb"], BACKGROUND)


@pytest.mark.parametrize("orthographic", [False, True])
def test_projected_covariance_is_that_of_the_linearised_camera(orthographic):
    scene = scenes.random_scene(6, 1, 0, spread=0.3)
    camera = scenes.camera(40, 30, aspect=1.2, eye=(1, -2, -3), roll=30)
    camera = scenes.parallel(camera) if orthographic else camera
    p = scenes.leaves(scene, requires_grad=False)
    viewmat, K = torch.tensor(camera.viewmat), torch.tensor(camera.K)
    splats = ref.project(*p.values(), viewmat, K, camera.width, camera.height, 0, False, orthographic)

    def pixel(x: torch.Tensor) -> torch.Tensor:
        point = viewmat[:3, :3] @ x + viewmat[:3, 3]
        return K[:2, :2] @ (point[:2] if orthographic else point[:2] / point[2]) + K[:2, 2]

    for k, i in enumerate(splats.index):
        J = torch.autograd.functional.jacobian(pixel, p["means"][i])
        axes = ref.rotations(p["quats"])[i] * p["log_scales"][i].exp()
        expected = J @ axes @ axes.T @ J.T + 0.3 * torch.eye(2, dtype=torch.float64)
        xx, xy, yy = splats.conic[k]
        conic = torch.stack([torch.stack([xx, xy]), torch.stack([xy, yy])])
        torch.testing.assert_close(conic @ expected, torch.eye(2, dtype=torch.float64), rtol=0, atol=1e-12)
        torch.testing.assert_close(splats.mean[k], pixel(p["means"][i]), rtol=1e-13, atol=1e-12)


def test_jacobian_is_clamped_at_1_3_half_views():
    camera = frontal(40, 20)
    K = torch.tensor(camera.K)
    low, high = ref.frustum_limits(K, 40, 20)
    np.testing.assert_allclose(high, [1.3 * 20 / 20, 1.3 * 10 / 20])
    np.testing.assert_allclose(low, -high)
    K_off = K + torch.tensor([[0, 0, 8.0], [0, 0, -3.0], [0, 0, 0]])  # principal point at (28, 7)
    limits = ref.frustum_limits(K_off, 40, 20)
    np.testing.assert_allclose(torch.stack(limits), [[-(28 + 6) / 20, -(7 + 3) / 20], [(12 + 6) / 20, (13 + 3) / 20]])
    J = ref.projection_jacobian(torch.tensor([[10.0, 0.5, 2.0]], dtype=torch.float64), K, 40, 20)[0]
    np.testing.assert_allclose(J, [[10, 0, -20 * 1.3 / 2], [0, 10, -20 * 0.25 / 2]])


def test_quaternion_is_a_rotation_about_its_axis():
    half = math.radians(90) / 2
    quat = torch.tensor([[math.cos(half), 0, 0, math.sin(half)]], dtype=torch.float64)
    for length in (1.0, 1e-3, 700.0):
        R = ref.rotations(length * quat)[0]
        np.testing.assert_allclose(R, [[0, -1, 0], [1, 0, 0], [0, 0, 1]], atol=1e-15)


# --- spherical harmonics


def test_sh_basis_is_orthonormal():
    """Quadrature over the sphere: Gauss–Legendre in z, equal steps in azimuth; exact for the degrees used."""
    z, weight = np.polynomial.legendre.leggauss(8)
    azimuth = np.arange(16) * 2 * np.pi / 16
    x, y = (np.outer(np.sqrt(1 - z**2), f(azimuth)) for f in (np.cos, np.sin))
    directions = np.stack([x, y, np.broadcast_to(z[:, None], x.shape)], 2).reshape(-1, 3)
    basis = ref.sh_basis(torch.tensor(directions), 3).numpy()
    gram = basis.T @ (basis * np.repeat(weight, 16)[:, None]) * 2 * np.pi / 16
    np.testing.assert_allclose(gram, np.eye(16), atol=1e-12)


def test_sh_band_one_is_minus_y_z_minus_x():
    basis = ref.sh_basis(torch.eye(3, dtype=torch.float64), 1)
    c = 0.4886025119029199
    np.testing.assert_allclose(basis[:, 1:], [[0, 0, -c], [-c, 0, 0], [0, c, 0]], atol=0)


def test_active_degree_ignores_higher_bands():
    scene, camera = scenes.random_scene(20, 1, 3), scenes.camera(16, 12)
    params = scenes.leaves(scene)
    short = params | {"sh": params["sh"][:, :4]}
    low, same = images(params, np.ones(20), camera, sh_degree=1), images(short, np.ones(20), camera)
    np.testing.assert_array_equal(low["rgb"], same["rgb"])
    assert np.abs(low["rgb"] - images(params, np.ones(20), camera)["rgb"]).max() > 1e-3


def test_colour_is_seen_from_the_camera_centre():
    """Band one, red only in the x coefficient: seen along +x it is 0.5 − c·sh, whatever the camera's rotation."""
    params = gaussians([(0, 0, 0)])
    sh = torch.zeros(1, 4, 3, dtype=torch.float64)
    sh[0, 3, 0] = 0.6
    camera = scenes.camera(5, 5, eye=(-3, 0, 0), roll=40)
    colour = ref.view_colours(params["means"], sh, torch.tensor(camera.viewmat), 1)
    np.testing.assert_allclose(colour.detach(), [[0.5 - 0.4886025119029199 * 0.6, 0.5, 0.5]], rtol=1e-13)


def test_negative_colours_are_black_without_gradient():
    params = gaussians([(0, 0, 2)], dc=-3.0)
    render = scenes.reference_render(params, [1], frontal(3, 3), (0, 0, 0))
    render.rgb.sum().backward()
    assert render.alpha.max() > 0.3 and not render.rgb.any() and not params["sh"].grad.any()


# --- compositing


def walk(alpha, hit, M, colour, z, mode, kind, eps) -> dict[str, object]:
    """One pixel, one splat at a time, as the text of the method says it."""
    T = T_full = 1.0
    C, depth, A, stopped, counted = np.zeros(3), 0.0, 0.0, False, []
    for i in np.flatnonzero(hit):
        if not stopped and T * (1 - M[i] * alpha[i]) < 1e-4:
            stopped = True
        if not stopped:
            C, depth, A = (total + M[i] * alpha[i] * T * x for total, x in ((C, colour[i]), (depth, z[i]), (A, 1)))
            T *= 1 - M[i] * alpha[i]
        if mode == "full" or not stopped:
            counted.append((alpha[i], M[i], T_full))
            T_full *= 1 - M[i] * alpha[i]
    N, K = len(counted), sum(m for _, m, _ in counted)
    terms = {
        "svr": lambda: sum(m * (1 - a * t) for a, m, t in counted) / math.log(1 + N),
        "b": lambda: sum(m * (1 - t) for _, m, t in counted) / math.log(1 + N),
        "a": lambda: sum(m / (a * t + eps) for a, m, t in counted) / sum(1 / (a * t + eps) for a, _, t in counted),
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
    splats = ref.project(*params.values(), torch.tensor(camera.viewmat), torch.tensor(camera.K), 6, 5, 1, False)
    alpha, hit = ref.alphas(splats, ref.pixel_centres(6, 5))
    for p in range(30):
        expected = walk(
            alpha[p].numpy(), hit[p].numpy(), masks[splats.index], splats.colour.numpy(), splats.z.numpy(),
            mode, kind, 1e-2,
        )  # fmt: skip
        for name in IMAGES:
            np.testing.assert_allclose(image[name][p // 6, p % 6], expected[name], rtol=1e-12, err_msg=name)


def test_full_and_visible_differ_behind_the_stop_only():
    """α = 0.8: T = 0.2, …, 3.2e-4 after five splats; the sixth stops. One masked-out hit in front of it, one behind."""
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
        np.testing.assert_allclose(both[0][name].grad[kept], both[1][name].grad, rtol=1e-9, atol=1e-13, err_msg=name)


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
        np.testing.assert_allclose(both[0][name].grad[order], both[1][name].grad, rtol=1e-9, atol=1e-13, err_msg=name)


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
    for params in (scenes.leaves(scenes.empty_scene()), gaussians([(0, 0, -1)]), gaussians([(0, 0, 2)], opacity=1e-3)):
        masks = torch.ones(len(params["means"]), dtype=torch.float64, requires_grad=True)
        render = scenes.reference_render(params, masks, frontal(3, 2), BACKGROUND)
        np.testing.assert_array_equal(render.rgb.detach(), np.broadcast_to(BACKGROUND, (2, 3, 3)))
        assert not render.F.any() and not render.N.any() and (render.T_full == 1).all()
        weighted_sum(render).backward()
        assert not masks.grad.any() and all(x.grad is None or not x.grad.any() for x in params.values())


@pytest.mark.parametrize("size", [(1, 1), (1, 5), (5, 1)])
def test_thin_images_are_pieces_of_larger_ones(size):
    """A crop is the same camera with its principal point moved, as long as no Jacobian is clamped in either."""
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
        render = scenes.reference_render(params, masks, scenes.CAMERAS[name], BACKGROUND, antialiased=name == "plain")
        weighted_sum(render).backward()
        assert all(torch.isfinite(getattr(render, image)).all() for image in IMAGES)
    assert all(torch.isfinite(x.grad).all() for x in params.values())


# --- loss


def test_ssim_at_a_corner_by_hand():
    """Zeros outside the image, weights not renormalised."""
    rng = np.random.default_rng(0)
    x, y = rng.random((2, 13, 9, 3))
    offsets = np.arange(11) - 5
    w = np.exp(-(offsets**2) / (2 * 1.5**2))
    w = np.outer(w, w) / w.sum() ** 2
    px, py = (np.pad(i[..., 1], 5)[1:12, 0:11] for i in (x, y))  # around row 1, column 0
    mx, my = (w * px).sum(), (w * py).sum()
    vx, vy, cov = (w * px * px).sum() - mx**2, (w * py * py).sum() - my**2, (w * px * py).sum() - mx * my
    expected = (2 * mx * my + 1e-4) * (2 * cov + 9e-4) / ((mx**2 + my**2 + 1e-4) * (vx + vy + 9e-4))
    assert loss.ssim_map(torch.tensor(x), torch.tensor(y))[1, 0, 1].item() == pytest.approx(expected, rel=1e-12)


def test_loss_of_equal_images_is_zero_and_weights_are_as_published():
    x, y = torch.rand(2, 8, 7, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(0))
    assert loss.photometric_loss(x, x).item() == pytest.approx(0, abs=1e-14)
    expected = 0.8 * (x - y).abs().mean() + 0.2 * (1 - loss.ssim(x, y))
    assert loss.photometric_loss(x, y).item() == pytest.approx(expected.item(), abs=1e-15)


def test_loss_gradient_is_the_finite_difference():
    x, y = torch.rand(2, 6, 5, 3, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    x.requires_grad_()
    loss.photometric_loss(x, y).backward()
    difference = central_difference(lambda image: loss.photometric_loss(image, y), x)
    torch.testing.assert_close(x.grad, difference, rtol=1e-6, atol=1e-9)


def test_mask_loss_counts_empty_pixels():
    F = torch.tensor([[3.0, 0.0], [0.0, 1.0]], dtype=torch.float64, requires_grad=True)
    loss.mask_loss(F).backward()
    assert loss.mask_loss(F).item() == 2.5
    np.testing.assert_allclose(F.grad, F.detach() / 2)
