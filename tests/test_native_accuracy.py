"""The chain of trust: native float64 against the reference and finite differences, each float level against the
reference and against the scalar one. Bounds are frozen at about 1.05 times the worst value seen, noted beside them."""

import functools
import math
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
    LEVELS,
    backward,
    frontal,
    image_weights,
    isotropic,
    relative_l2,
    render,
    typed,
)
from reference import gradients as ray
from reference import rasterize as ref

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


def reference_images(params, masks, camera, *, mask_kind, full, antialiased, **rest) -> dict[str, torch.Tensor]:
    """The reference's images under the native names and options."""
    kind, gradient = ("svr", "self") if mask_kind == "self" else (mask_kind, "exact")
    result = scenes.reference_render(
        params, masks, camera, BACKGROUND, antialiased=antialiased, mode="full" if full else "visible",
        mask_kind=kind, mask_gradient=gradient, **rest,
    )  # fmt: skip
    return {name: getattr(result, REFERENCE_NAMES.get(name, name)) for name in (*FLOAT_IMAGES, "hits", "kept")}


@functools.cache
def prepared(name: str):
    """Scene and mixed masks of a case, away from every threshold."""
    kind, full, antialiased = CASES[name]
    seed = list(CASES).index(name)
    scene = scenes.random_scene(40, seed, seed % 4, scale=0.3, opacity=1.5, antialiased=antialiased)
    masks = scenes.random_masks(40, seed)
    return scenes.away_from_thresholds(scene, CAMERAS[name], masks, rounds=60)


@functools.cache
def reference(name: str) -> tuple[dict, dict]:
    """The reference's images, and the gradients of their sum weighted by image_weights; the gradient of F reaches M only."""
    (scene, masks), camera = prepared(name), CAMERAS[name]
    params, M = scenes.leaves(scene), torch.tensor(masks, dtype=torch.float64, requires_grad=True)
    options = options_of(*CASES[name])
    images = reference_images(params, M, camera, **options)
    terms = {k: (images[k] * torch.tensor(w)).sum() for k, w in image_weights(camera).items()}
    (of_F,) = torch.autograd.grad(terms.pop("mask"), [M], retain_graph=True)
    leaves = params | {"masks": M}
    grads = dict(zip(leaves, torch.autograd.grad(sum(terms.values()), list(leaves.values())), strict=True))
    grads = {k: (gradient + of_F if k == "masks" else gradient).numpy() for k, gradient in grads.items()}
    return {k: image.detach().numpy() for k, image in images.items()}, grads


@functools.cache
def native_result(level: str, name: str) -> tuple[dict, dict]:
    (scene, masks), camera = prepared(name), CAMERAS[name]
    images = render(level, scene, camera, masks, **options_of(*CASES[name]))
    return images, backward(level, image_weights(camera), scene.count, (*ARRAYS, "masks"))


def image_errors(images: dict, expected: dict) -> dict[str, float]:
    """Largest difference of each real image, in units of 1 (depth: of the scene's depth, up to 10 here)."""
    return {name: float(np.abs(images[name] - expected[name]).max()) for name in FLOAT_IMAGES}


@pytest.mark.parametrize("name", CASES)
def test_float64_equals_the_reference(name):
    (images, grads), (expected, expected_grads) = native_result("float64", name), reference(name)
    for image in FLOAT_IMAGES:
        np.testing.assert_allclose(images[image], expected[image], rtol=1e-9, atol=1e-12, err_msg=image)
    for count in ("hits", "kept"):
        np.testing.assert_array_equal(images[count], expected[count])
    for array, gradient in expected_grads.items():
        scale = np.abs(gradient).max()
        np.testing.assert_allclose(grads[array], gradient, rtol=1e-7, atol=1e-11 * max(scale, 1), err_msg=array)


def test_cases_cover_what_they_claim():
    """Stops, masked-out hits and empty pixels all occur; every tensor has a gradient."""
    results = [reference(name) for name in CASES]
    assert any((images["transmittance"] < 1e-4).any() for images, _ in results)
    assert sum((images["kept"] < images["hits"]).any() for images, _ in results) >= 12
    assert any((images["hits"] == 0).any() for images, _ in results)
    assert all(prepared(name)[0].count >= 20 for name in CASES)
    for array in (*ARRAYS, "masks"):
        assert sum(np.abs(grads[array]).max() > 1e-3 for _, grads in results) >= 12, array


# The contract is 2e-5 for images and 1e-4 relative L2 for gradients; these bounds are what is reached. Worst seen:
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
    "opacity_logits": 2.1e-6,  # 1.97e-6
    "sh": 1.6e-6,  # 1.50e-6
    "masks": 1.6e-6,  # 1.51e-6
}


@pytest.mark.parametrize("level", FLOAT_LEVELS)
@pytest.mark.parametrize("name", CASES)
def test_float_levels_agree_with_the_reference(name, level):
    (images, grads), (expected, expected_grads) = native_result(level, name), reference(name)
    for image, error in image_errors(images, expected).items():
        assert error <= IMAGE_BOUND[image], (image, error)
    for count in ("hits", "kept"):
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


def test_active_sh_degree_is_that_of_the_reference():
    scene, camera = scenes.random_scene(30, 5, 3, scale=0.3), scenes.camera(17, 12)
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(30, 5), rounds=60)
    for degree in (0, 1, 2):
        params = scenes.leaves(scene)
        expected = reference_images(params, masks, camera, mask_kind="svr", full=True, antialiased=False, sh_degree=degree)
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
    return np.where(rng.random(shape) < 0.2, rng.choice([0.0, -1.0, np.inf, np.nan], shape), limit).astype(np.float32)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", CASES)
def test_nothing_behind_a_depth_limit_is_taken(name, level):
    (scene, masks), camera, limit = prepared(name), CAMERAS[name], depth_limit(name)
    options = options_of(*CASES[name])
    images = render(level, scene, camera, masks, depth_limit=limit, **options)
    params = scenes.leaves(scene, requires_grad=False)
    expected = {k: image.numpy() for k, image in reference_images(params, masks, camera, depth_limit=torch.tensor(limit), **options).items()}
    for image, error in image_errors(images, expected).items():
        assert error <= (1e-9 if level == "float64" else IMAGE_BOUND[image]), (image, error)
    for count in ("hits", "kept"):
        np.testing.assert_array_equal(images[count], expected[count])


def test_depth_limits_bite():
    """Cut rays, empty ones and whole ones all occur."""
    for name in ("plain", "tiles", "parallel_rotated"):
        (scene, masks), camera = prepared(name), CAMERAS[name]
        cut, whole = (render("float64", scene, camera, masks, depth_limit=limit)["hits"] for limit in (depth_limit(name), None))
        assert all(share.mean() > 0.04 for share in (cut == 0, (0 < cut) & (cut < whole), cut == whole))


# --- finite differences of the native float64 itself


DIFFERENCE_CASES = {
    "plain": (scenes.random_scene(6, 1, 3, scale=0.3), scenes.camera(9, 7), {}),
    "antialiased": (
        scenes.random_scene(8, 2, 1, scale=0.2, antialiased=True),
        scenes.CAMERAS["rotated"].resized(10, 8),
        {"mask_kind": "b"},
    ),
    "scenario_a": (
        scenes.random_scene(8, 3, 2, scale=0.3),
        scenes.camera(7, 9, shift=(0.4, -0.3)),
        {"mask_kind": "a"},
    ),
    "stopping": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {}),
    "stopping_visible": (scenes.opaque_stack(24, 4, 0), scenes.camera(5, 4), {"full": False}),
    "clamped": (scenes.off_screen(8, 5, 0), scenes.camera(6, 8), {}),
    "orthographic": (scenes.random_scene(6, 6, 3, scale=0.3), scenes.parallel(scenes.CAMERAS["rotated"].resized(9, 7)), {}),
    "orthographic_antialiased": (
        scenes.random_scene(8, 7, 2, scale=0.2, antialiased=True),
        scenes.parallel(scenes.camera(8, 9, shift=(0.4, -0.3), aspect=0.8)),
        {"mask_kind": "b"},
    ),
}


@functools.cache
def difference_case(name: str):
    scene, camera, options = DIFFERENCE_CASES[name]
    scene, masks = scenes.away_from_thresholds(scene, camera, scenes.random_masks(scene.count, 7))
    assert scene.count >= 6 and 0 < masks.sum() < len(masks)
    return scene, masks, camera, options | {"antialiased": scene.antialiased}


@pytest.mark.parametrize("name", DIFFERENCE_CASES)
def test_every_gradient_is_the_finite_difference(name):
    scene, masks, camera, options = difference_case(name)
    weights = {k: w / w[..., :1].size for k, w in image_weights(camera).items() if k != "mask"}  # F has a gradient to masks only
    params = typed(scene, np.float64)

    def value() -> float:
        images = render("float64", params, camera, masks, FLOAT_IMAGES, **options)
        return math.fsum((images[k] * w).sum() for k, w in weights.items())

    value()
    grads = backward("float64", weights, scene.count, ARRAYS)
    for array in ARRAYS:
        values, difference = getattr(params, array).reshape(-1), np.zeros(getattr(params, array).size)
        for i, x in enumerate(values.copy()):
            sides = []
            for values[i] in (x - 1e-6, x + 1e-6):
                sides.append(value())
            values[i] = x
            difference[i] = (sides[1] - sides[0]) / 2e-6
        assert np.abs(difference).max() > 1e-4, array
        np.testing.assert_allclose(grads[array].ravel(), difference, rtol=1e-6, atol=2e-9, err_msg=array)


@pytest.mark.parametrize("kind", ["svr", "b"])
def test_mask_gradient_is_the_difference_between_present_and_absent(kind):
    """C, depth, alpha, F and F_B are linear in each M_i: where nothing stops, the step from 0 to 1 is the derivative."""
    scene, camera = scenes.random_scene(12, 3, 1, scale=0.3, opacity=0.0), scenes.camera(21, 18)
    masks, weights = scenes.random_masks(12, 3, keep=0.5), image_weights(camera)
    assert render("float64", scene, camera, np.ones(12))["transmittance"].min() > 2e-4

    def value(masks: np.ndarray) -> float:
        images = render("float64", scene, camera, masks, mask_kind=kind)
        return math.fsum((images[k] * w).sum() for k, w in weights.items())

    value(masks)
    gradient = backward("float64", weights, 12, ("masks",))["masks"]
    for i in range(12):
        present, absent = (np.where(np.arange(12) == i, m, masks) for m in (1, 0))
        assert gradient[i] == pytest.approx(value(present) - value(absent), rel=1e-10, abs=1e-10)
    assert (np.abs(gradient) > 1e-3).all()


# --- one ray by hand


ALPHA, COLOUR, B = (0.5, 0.25, 0.8), (1.0, 0.2, 0.5), 0.1
VECTORS = [  # M, C, T_N, dC/dM, F, dF/dM
    (
        (1, 1, 1), 0.682500, 0.075, (0.3175, -0.0275, 0.12), 1.496796,
        (0.667246, 0.703314, 0.504943),
    ),
    (
        (1, 0, 1), 0.710000, 0.1, (0.29, -0.0275, 0.16), 0.793482,
        (0.649213, 0.703314, 0.432809),
    ),
    (
        (0, 1, 1), 0.365000, 0.15, (0.3175, -0.055, 0.24), 0.829550,
        (0.667246, 0.685280, 0.288539),
    ),
]  # fmt: skip
SCENARIO_VECTORS = [  # M, F_A, dF_A/dM, F_B, dF_B/dM
    ((1, 1, 1), 1.000000, (0.150588, 0.598766, 0.250646), 0.811516, (0.631179, 0.450842, 0.450842)),
    ((1, 0, 1), 0.361313, (0.059549, 0.670651, 0.200685), 0.360674, (0.360674, 0.450842, 0.360674)),
    ((0, 1, 1), 0.738878, (0.357272, 0.540119, 0.217674), 0.180337, (0.631179, 0.180337, 0.180337)),
]


def ray_scene(alpha=ALPHA, colour=COLOUR):
    """Gaussians centred on the only pixel, so that alpha is the opacity."""
    dc = (np.array(colour) - 0.5) / 0.28209479177387814
    return isotropic([(0, 0, 2 + i) for i in range(len(alpha))], opacity=alpha, dc=dc)


def on_ray(level, M, image, kind="svr", alpha=ALPHA, colour=COLOUR, background=B):
    """The images of the ray, and the gradients of one of them: with respect to M, and to alpha."""
    images = render(
        level, ray_scene(alpha, colour), frontal(1, 1), M,
        mask_kind=kind, background=(background,) * 3,
    )  # fmt: skip
    weight = np.array([[[1.0, 0, 0]]]) if image == "rgb" else np.ones((1, 1))
    grads = backward(level, {image: weight}, len(alpha), ("masks", "opacity_logits"))
    a = np.array(alpha)
    return {k: image.ravel()[0] for k, image in images.items()}, grads["masks"], grads["opacity_logits"] / (a * (1 - a))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("M", "C", "T_N", "dC_dM", "F", "dF_dM"), VECTORS)
def test_published_vectors(level, M, C, T_N, dC_dM, F, dF_dM):
    close = {"rtol": 0, "atol": 6e-7 if level == "float64" else 1.1e-6}
    pixel, by_mask, _ = on_ray(level, M, "rgb")
    np.testing.assert_allclose([pixel["rgb"], pixel["transmittance"], pixel["mask"]], [C, T_N, F], **close)
    np.testing.assert_allclose(by_mask, dC_dM, **close)
    _, by_mask, by_alpha = on_ray(level, M, "mask")
    np.testing.assert_allclose(by_mask, dF_dM, **close)
    assert not by_alpha.any()
    assert (pixel["hits"], pixel["kept"]) == (3, sum(M))


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("M", "F_A", "dF_A", "F_B", "dF_B"), SCENARIO_VECTORS)
def test_published_vectors_of_the_scenarios(level, M, F_A, dF_A, F_B, dF_B):
    close = {"rtol": 0, "atol": 6e-7 if level == "float64" else 1.1e-6}
    for kind, F, dF in (("a", F_A, dF_A), ("b", F_B, dF_B)):
        pixel, by_mask, _ = on_ray(level, M, "mask", kind)
        assert pixel["mask"] == pytest.approx(F, rel=0, abs=close["atol"])
        np.testing.assert_allclose(by_mask, dF, **close)


@pytest.mark.parametrize("seed", range(8))
def test_float64_equals_the_printed_formulas_on_random_rays(seed):
    rng = np.random.default_rng(seed)
    n = seed + 1
    alpha, colour, M = rng.uniform(0.02, 0.6, n), rng.uniform(0, 1, n), rng.integers(0, 2, n)
    close = {"rtol": 1e-11, "atol": 1e-13}
    pixel, by_mask, by_alpha = on_ray("float64", M, "rgb", alpha=alpha, colour=colour)
    assert pixel["rgb"] == pytest.approx(ray.colour(alpha, M, colour, B), rel=1e-12)
    np.testing.assert_allclose(by_mask, ray.dC_dM(alpha, M, colour, B), **close)
    np.testing.assert_allclose(by_alpha, ray.dC_dalpha(alpha, M, colour, B), **close)
    forms = {
        "svr": (ray.paper_F, ray.paper_dF_dM),
        "self": (ray.paper_F, ray.self_dF_dM),
        "a": (ray.scenario_a_F, ray.scenario_a_dF_dM),
        "b": (ray.scenario_b_F, ray.scenario_b_dF_dM),
    }
    for kind, (F, dF_dM) in forms.items():
        pixel, by_mask, _ = on_ray("float64", M, "mask", kind, alpha, colour)
        assert pixel["mask"] == pytest.approx(F(alpha, M), rel=1e-12, abs=1e-15)
        np.testing.assert_allclose(by_mask, dF_dM(alpha, M), **close, err_msg=kind)


@pytest.mark.parametrize("level", LEVELS)
def test_early_stop_is_where_the_reference_stops(level):
    """alpha 0.8: T = 3.2e-4 after five; the sixth stops and is not blended. Clamped alphas stop after two."""
    for alpha, blended in (([0.8] * 12, 5), ([0.9999] * 4, 1)):
        a = min(alpha[0], 0.99)
        full, *_ = on_ray(level, [1] * len(alpha), "rgb", alpha=alpha, colour=[0.5] * len(alpha), background=0.0)
        assert full["alpha"] == pytest.approx(1 - (1 - a) ** blended, rel=1e-6)
        assert full["rgb"] == pytest.approx(0.5 * (1 - (1 - a) ** blended), rel=1e-6)
        assert full["transmittance"] == pytest.approx((1 - a) ** len(alpha), rel=3e-5)
        assert full["hits"] == len(alpha)


def test_scenario_epsilon_reaches_the_kernel():
    scene, camera = scenes.random_scene(20, 4, 0, scale=0.3), scenes.camera(12, 9)
    masks = scenes.random_masks(20, 4)
    for eps in (1e-6, 1e-1):
        options = {"mask_kind": "a", "full": True, "antialiased": False}
        expected = reference_images(scenes.leaves(scene), masks, camera, eps_a=eps, **options)["mask"].detach()
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
    """EVEN: dL/dM from F times 256 pixels over the Gaussian's own 1/255 ellipse; the colours' share is not touched."""
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
        **scenes.leaves(scene, requires_grad=False), viewmat=torch.as_tensor(camera.viewmat), K=torch.as_tensor(camera.K),
        width=camera.width, height=camera.height, degree=3, antialiased=False,
    )  # fmt: skip
    xx, xy, yy = splats.conic.T
    area = np.full(60, np.inf)
    area[splats.index] = 2 * np.pi * torch.log(255 * splats.opacity) / torch.sqrt(xx * yy - xy**2)
    seen = grads["svr", "F"] != 0
    np.testing.assert_allclose(grads["even", "F"][seen], (grads["svr", "F"] * 256 / np.maximum(area, 1))[seen], rtol=1e-3)
    np.testing.assert_array_equal(grads["even", "rgb"], grads["svr", "rgb"])
    assert seen.sum() > 30
