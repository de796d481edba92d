"""The reference rasterizer: gradients against finite differences, one Gaussian and spherical harmonics by
hand."""

import math

import numpy as np
import pytest
import torch

import scenes
from reference import rasterize as ref
from reference.gradients import central_difference
from reference_renders import BACKGROUND, frontal, gaussians, images, weighted_sum

# --- gradients


CASES = {
    "plain": (scenes.random_scene(6, 1, 3, scale=0.3), scenes.camera(9, 7), {}),
    "antialiased": (
        scenes.random_scene(8, 2, 0, scale=0.2, antialiased=True),
        scenes.CAMERAS["rotated"].resized(10, 8),
        {"mask_kind": "b"},
    ),
    "scenario_a": (
        scenes.random_scene(8, 3, 0, scale=0.3),
        scenes.camera(7, 9, shift=(0.4, -0.3)),
        {"mask_kind": "a"},
    ),
    "stopping": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"mode": "full"}),
    "stopping_visible": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"mode": "visible"}),
    "clamped": (scenes.off_screen(8, 5, 0), scenes.camera(6, 8), {}),
    "orthographic": (
        scenes.random_scene(6, 6, 3, scale=0.3),
        scenes.parallel(scenes.CAMERAS["rotated"].resized(9, 7)),
        {},
    ),
}


def prepared(case: str):
    """Scene, masks, camera and options of a case, away from every threshold."""
    scene, camera, options = CASES[case]
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(scene.count, 7))
    assert scene.count >= 6 and 0 < masks.sum() < len(masks)
    return scene, masks, camera, options | {"antialiased": scene.antialiased}


LONG = {"stopping", "stopping_visible", "orthographic"}  # cases that take seconds


@pytest.mark.parametrize(
    "case", [pytest.param(case, marks=[pytest.mark.slow] if case in LONG else []) for case in CASES]
)
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
    """Focal 20, depth 2, σ 0.1: one px², plus the blur 1.3 px²; the pixel (6, 4) is (2, 1) px from the
    centre."""
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
    np.testing.assert_allclose(
        torch.stack(limits), [[-(28 + 6) / 20, -(7 + 3) / 20], [(12 + 6) / 20, (13 + 3) / 20]]
    )
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
    """Band one, red only in the x coefficient: seen along +x it is 0.5 − c·sh, whatever the camera's
    rotation."""
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
