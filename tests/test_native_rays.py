"""One ray by hand: the native core against published vectors and printed formulas."""

import numpy as np
import pytest

from native_helpers import LEVELS, backward, frontal, isotropic, render
from reference import gradients as ray

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
    return (
        {k: image.ravel()[0] for k, image in images.items()},
        grads["masks"],
        grads["opacity_logits"] / (a * (1 - a)),
    )


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
        full, *_ = on_ray(
            level, [1] * len(alpha), "rgb", alpha=alpha, colour=[0.5] * len(alpha), background=0.0
        )
        assert full["alpha"] == pytest.approx(1 - (1 - a) ** blended, rel=1e-6)
        assert full["rgb"] == pytest.approx(0.5 * (1 - (1 - a) ** blended), rel=1e-6)
        assert full["transmittance"] == pytest.approx((1 - a) ** len(alpha), rel=3e-5)
        assert full["hits"] == len(alpha)
