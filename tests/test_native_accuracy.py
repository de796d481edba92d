"""The chain of trust: float64 agrees with the reference, and each float level with the reference and the
scalar one."""

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from native_helpers import (
    ARRAYS,
    BACKGROUND,
    FLOAT_IMAGES,
    FLOAT_LEVELS,
    IMAGES,
    LEVELS,
    backward,
    image_weights,
    relative_l2,
    render,
)
from reference import rasterize as ref
from svrgs_addon.native.rasterizer import COUNTS

KINDS = ("svr", "self", "a", "b")
SIZES = {  # around tile edges, and many tiles in a row
    "15": scenes.camera(15, 15),
    "16": scenes.camera(16, 16),
    "17": scenes.camera(17, 17),
    "257": scenes.camera(257, 3, fov=90),
    "tall": scenes.camera(3, 65, fov=5),
}
PERSPECTIVE = scenes.CAMERAS | SIZES
COMBINATIONS = [(kind, full, aa) for kind in KINDS for full in (True, False) for aa in (False, True)]
CASES = dict(zip(PERSPECTIVE, COMBINATIONS, strict=True))  # every camera once, every combination once
CASES |= dict(zip(scenes.ORTHOGRAPHIC, [COMBINATIONS[k] for k in (0, 1, 2, 9, 13)], strict=True))
CAMERAS = PERSPECTIVE | scenes.ORTHOGRAPHIC
REFERENCE_NAMES = {"mask": "F", "transmittance": "T_full", "hits": "N", "kept": "K"}


def options_of(kind: str, full: bool, antialiased: bool) -> dict:
    return {"mask_kind": kind, "full": full, "antialiased": antialiased}


def reference_images(
    params, masks, camera, *, mask_kind, full, antialiased, **rest
) -> dict[str, torch.Tensor]:
    """The reference's images under the native names and options."""
    kind, gradient = ("svr", "self") if mask_kind == "self" else (mask_kind, "exact")
    result = scenes.reference_render(
        params, masks, camera, BACKGROUND, antialiased=antialiased, mode="full" if full else "visible",
        mask_kind=kind, mask_gradient=gradient, **rest,
    )  # fmt: skip
    return {name: getattr(result, REFERENCE_NAMES.get(name, name)) for name in IMAGES}


@functools.cache
def prepared(name: str):
    """Scene and mixed masks of a case, away from every threshold."""
    kind, full, antialiased = CASES[name]
    seed = list(CASES).index(name)
    scene = scenes.random_scene(40, seed, seed % 4, scale=0.3, opacity=1.5, antialiased=antialiased)
    masks = scenes.random_masks(40, seed)
    return scenes.away_from_thresholds(scene, CAMERAS[name], masks, rounds=60)


def displaced(camera: scenes.Camera, motion: torch.Tensor) -> torch.Tensor:
    """The viewmat (4, 4) of Camera.displaced(motion), differentiable."""
    viewmat, (x, y, z) = torch.tensor(camera.viewmat), motion[:3]
    zero = torch.zeros_like(x)
    turn = torch.stack([zero, -z, y, z, zero, -x, -y, x, zero]).reshape(3, 3)
    R = torch.matrix_exp(-turn)
    moved = torch.cat([torch.cat([R, -R @ motion[3:, None]], dim=1), viewmat[3:]])
    return moved @ viewmat


def of_camera(motion: np.ndarray, camera: scenes.Camera) -> np.ndarray:
    """What svrgs_grads.camera promises: of an orthographic camera, a rotation counts without the colours."""
    return motion[3:] if camera.orthographic else motion


@functools.cache
def reference(name: str) -> tuple[dict, dict]:
    """The reference's images, and the gradients of their sum weighted by image_weights; the gradient of F
    reaches M only."""
    (scene, masks), camera = prepared(name), CAMERAS[name]
    params, M = scenes.leaves(scene), torch.tensor(masks, dtype=torch.float64, requires_grad=True)
    motion, options = torch.zeros(6, dtype=torch.float64, requires_grad=True), options_of(*CASES[name])
    images = reference_images(params, M, replace(camera, viewmat=displaced(camera, motion)), **options)
    terms = {k: (images[k] * torch.tensor(w)).sum() for k, w in image_weights(camera).items()}
    (of_F,) = torch.autograd.grad(terms.pop("mask"), [M], retain_graph=True)
    leaves = params | {"masks": M, "camera": motion}
    grads = dict(zip(leaves, torch.autograd.grad(sum(terms.values()), list(leaves.values())), strict=True))
    grads = {k: (gradient + of_F if k == "masks" else gradient).numpy() for k, gradient in grads.items()}
    grads["camera"] = of_camera(grads["camera"], camera)
    return {k: image.detach().numpy() for k, image in images.items()}, grads


@functools.cache
def native_result(level: str, name: str) -> tuple[dict, dict]:
    (scene, masks), camera = prepared(name), CAMERAS[name]
    images = render(level, scene, camera, masks, **options_of(*CASES[name]))
    grads = backward(level, image_weights(camera), scene.count)
    grads["camera"] = of_camera(grads["camera"].sum(axis=0, dtype=np.float64), camera)
    return images, grads


def image_errors(images: dict, expected: dict) -> dict[str, float]:
    """Largest difference of each real image, in units of 1 (depth: of the scene's depth, up to 10 here)."""
    return {name: float(np.abs(images[name] - expected[name]).max()) for name in FLOAT_IMAGES}


@pytest.mark.parametrize("name", CASES)
def test_float64_equals_the_reference(name):
    (images, grads), (expected, expected_grads) = native_result("float64", name), reference(name)
    for image in FLOAT_IMAGES:
        np.testing.assert_allclose(images[image], expected[image], rtol=1e-9, atol=1e-12, err_msg=image)
    for count in COUNTS:
        np.testing.assert_array_equal(images[count], expected[count])
    for array, gradient in expected_grads.items():
        scale = np.abs(gradient).max()
        np.testing.assert_allclose(
            grads[array], gradient, rtol=1e-7, atol=1e-11 * max(scale, 1), err_msg=array
        )


def test_cases_cover_what_they_claim():
    """Stops, masked-out hits and empty pixels all occur; every tensor has a gradient."""
    results = [reference(name) for name in CASES]
    assert any((images["transmittance"] < 1e-4).any() for images, _ in results)
    assert sum((images["kept"] < images["hits"]).any() for images, _ in results) >= 12
    assert any((images["hits"] == 0).any() for images, _ in results)
    assert all(prepared(name)[0].count >= 20 for name in CASES)
    for array in (*ARRAYS, "masks"):
        assert sum(np.abs(grads[array]).max() > 1e-3 for _, grads in results) >= 12, array


# The contract is 2e-5 for images and 1e-4 relative L2 for gradients. These bounds are what is reached: they
# are frozen at about 1.05 times the worst value seen, which is noted beside them. Processors differ in their
# estimates of 1/x and 1/sqrt(x).
IMAGE_BOUND = {
    "rgb": 4.6e-7,  # 4.39e-7
    "depth": 2.35e-6,  # 2.20e-6
    "alpha": 5.8e-7,  # 5.47e-7
    "mask": 1.3e-6,  # 1.21e-6
    "transmittance": 5.8e-7,  # 5.47e-7
}
GRADIENT_BOUND = {
    "means": 1.5e-6,  # 1.42e-6
    "log_scales": 1.3e-6,  # 1.22e-6
    "quats": 2.5e-6,  # 2.34e-6
    "opacity_logits": 2.2e-6,  # 2.11e-6
    "sh": 1.6e-6,  # 1.50e-6
    "masks": 1.6e-6,  # 1.51e-6
    "camera": 1.8e-6,  # 1.70e-6
}


@pytest.mark.parametrize("level", FLOAT_LEVELS)
@pytest.mark.parametrize("name", CASES)
def test_float_levels_agree_with_the_reference(name, level):
    (images, grads), (expected, expected_grads) = native_result(level, name), reference(name)
    for image, error in image_errors(images, expected).items():
        assert error <= IMAGE_BOUND[image], (image, error)
    for count in COUNTS:
        np.testing.assert_array_equal(images[count], expected[count])
    for array, gradient in expected_grads.items():
        assert relative_l2(grads[array], gradient) <= GRADIENT_BOUND[array], array
        rows = gradient.reshape(len(gradient), -1).any(1)
        np.testing.assert_array_equal(grads[array].reshape(len(gradient), -1).any(1), rows, err_msg=array)


SIMD_IMAGE_BOUND = 1.75e-6  # worst seen: 1.67e-6, depth
SIMD_GRADIENT_BOUND = 2.7e-6  # worst seen: 2.56e-6, opacity_logits


@pytest.mark.parametrize("level", [level for level in FLOAT_LEVELS if level != "scalar"])
@pytest.mark.parametrize("name", CASES)
def test_simd_levels_agree_with_scalar(name, level):
    (images, grads), (expected, expected_grads) = native_result(level, name), native_result("scalar", name)
    assert max(image_errors(images, expected).values()) <= SIMD_IMAGE_BOUND
    assert max(relative_l2(grads[array], g) for array, g in expected_grads.items()) <= SIMD_GRADIENT_BOUND


@pytest.mark.parametrize("name", CASES)
def test_the_camera_moves_as_its_gradient_says(name):
    camera, motion = CAMERAS[name], np.random.default_rng(0).normal(0, 0.3, 6)
    expected = displaced(camera, torch.tensor(motion)).numpy()
    np.testing.assert_allclose(camera.displaced(motion).viewmat, expected, rtol=1e-12, atol=1e-12)


def test_active_sh_degree_is_that_of_the_reference():
    scene, camera = scenes.random_scene(30, 5, 3, scale=0.3), scenes.camera(17, 12)
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(30, 5), rounds=60)
    for degree in (0, 1, 2):
        params = scenes.leaves(scene)
        expected = reference_images(
            params, masks, camera, mask_kind="svr", full=True, antialiased=False, sh_degree=degree
        )
        weights = {"rgb": image_weights(camera)["rgb"]}
        (expected["rgb"] * torch.tensor(weights["rgb"])).sum().backward()
        images = render("float64", scene, camera, masks, sh_degree=degree)
        grads = backward("float64", weights, scene.count, ("sh", "means"))
        np.testing.assert_allclose(images["rgb"], expected["rgb"].detach(), rtol=1e-12)
        for array in grads:
            np.testing.assert_allclose(grads[array], params[array].grad, rtol=1e-9, atol=1e-12, err_msg=array)
        assert not grads["sh"][:, (degree + 1) ** 2 :].any() and grads["sh"][:, : (degree + 1) ** 2].any()


# --- depth limits


def depth_limit(name: str) -> np.ndarray:
    """(H, W) float32 around the depths of a case, with pixels that end at once, never, or at no number."""
    (scene, _), camera = prepared(name), CAMERAS[name]
    z = scene.means @ camera.viewmat[2, :3] + camera.viewmat[2, 3]
    rng, shape = np.random.default_rng(1), (camera.height, camera.width)
    limit = rng.uniform(z.min(), z.max(), shape)
    return np.where(rng.random(shape) < 0.2, rng.choice([0.0, -1.0, np.inf, np.nan], shape), limit).astype(
        np.float32
    )


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", CASES)
def test_nothing_behind_a_depth_limit_is_taken(name, level):
    (scene, masks), camera, limit = prepared(name), CAMERAS[name], depth_limit(name)
    options = options_of(*CASES[name])
    images = render(level, scene, camera, masks, depth_limit=limit, **options)
    params = scenes.leaves(scene, requires_grad=False)
    expected = {
        k: image.numpy()
        for k, image in reference_images(
            params, masks, camera, depth_limit=torch.tensor(limit), **options
        ).items()
    }
    for image, error in image_errors(images, expected).items():
        assert error <= (1e-9 if level == "float64" else IMAGE_BOUND[image]), (image, error)
    for count in COUNTS:
        np.testing.assert_array_equal(images[count], expected[count])


def test_depth_limits_bite():
    """Cut rays, empty ones and whole ones all occur."""
    for name in ("plain", "tiles", "parallel_rotated"):
        (scene, masks), camera = prepared(name), CAMERAS[name]
        cut, whole = (
            render("float64", scene, camera, masks, depth_limit=limit)["hits"]
            for limit in (depth_limit(name), None)
        )
        assert all(share.mean() > 0.04 for share in (cut == 0, (0 < cut) & (cut < whole), cut == whole))


# --- options


def test_scenario_epsilon_reaches_the_kernel():
    scene, camera = scenes.random_scene(20, 4, 0, scale=0.3), scenes.camera(12, 9)
    masks = scenes.random_masks(20, 4)
    for eps in (1e-6, 1e-1):
        options = {"mask_kind": "a", "full": True, "antialiased": False}
        expected = reference_images(scenes.leaves(scene), masks, camera, eps_a=eps, **options)[
            "mask"
        ].detach()
        image = render("float64", scene, camera, masks, eps_a=eps, **options)["mask"]
        np.testing.assert_allclose(image, expected, rtol=1e-9)


def test_antialiasing_is_an_option_not_a_property_of_the_scene():
    """RenderOptions decides: the library takes only arrays."""
    scene, camera = scenes.random_scene(20, 4, 0, scale=0.05), scenes.camera(12, 9)
    sharp = [render("float64", s, camera)["rgb"] for s in (scene, replace(scene, antialiased=True))]
    np.testing.assert_array_equal(*sharp)
    assert np.abs(render("float64", scene, camera, antialiased=True)["rgb"] - sharp[0]).max() > 1e-2


@pytest.mark.parametrize("level", LEVELS)
def test_even_scales_the_mask_gradient_of_f_to_one_footprint(level):
    """EVEN: dL/dM from F times 256 pixels over the Gaussian's own 1/255 ellipse; the colours' share is not
    touched."""
    scene, camera = scenes.random_scene(60, seed=9, scale=0.2, opacity=1.0), scenes.CAMERAS["plain"]
    masks = scenes.random_masks(60, seed=2)
    weights = image_weights(camera, seed=4)
    from_f = {"mask": weights["mask"]}
    grads = {}
    for kind in ("svr", "even"):
        for name, parts in (("F", from_f), ("rgb", {"rgb": weights["rgb"]})):
            render(level, scene, camera, masks, mask_kind=kind)
            grads[kind, name] = backward(level, parts, 60, ("masks",))["masks"]
    splats = ref.project(
        **scenes.leaves(scene, requires_grad=False), viewmat=torch.as_tensor(camera.viewmat),
        K=torch.as_tensor(camera.K),
        width=camera.width, height=camera.height, degree=3, antialiased=False,
    )  # fmt: skip
    xx, xy, yy = splats.conic.T
    area = np.full(60, np.inf)
    area[splats.index] = 2 * np.pi * torch.log(255 * splats.opacity) / torch.sqrt(xx * yy - xy**2)
    seen = grads["svr", "F"] != 0
    np.testing.assert_allclose(
        grads["even", "F"][seen], (grads["svr", "F"] * 256 / np.maximum(area, 1))[seen], rtol=1e-3
    )
    np.testing.assert_array_equal(grads["even", "rgb"], grads["svr", "rgb"])
    assert seen.sum() > 30
