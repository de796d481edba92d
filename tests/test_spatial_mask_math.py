"""The spatial mask on one ray: closed form = the paper's sum, printed gradients = autograd = finite
differences."""

import math

import numpy as np
import pytest
import torch

from reference import gradients as g
from reference import rasterize as ref

FORMS = {  # value, printed gradient
    "svr": (g.paper_F, g.paper_dF_dM),
    "a": (g.scenario_a_F, g.scenario_a_dF_dM),
    "b": (g.scenario_b_F, g.scenario_b_dF_dM),
}

ALPHA, COLOUR, BACKGROUND = [0.5, 0.25, 0.8], [1.0, 0.2, 0.5], 0.1
# M: C, T_0..T_3, dC/dM, | F, dF/dM, dF/dalpha, | F_A, dF_A/dM, F_B, dF_B/dM; rounded to 6 decimals
VECTORS = {
    (1, 1, 1): (
        0.682500, [1, 0.5, 0.375, 0.075], [0.3175, -0.0275, 0.12],
        1.496796, [0.667246, 0.703314, 0.504943], [-0.108202, -0.072135, -0.270505],
        1.000000, [0.150588, 0.598766, 0.250646], 0.811516, [0.631179, 0.450842, 0.450842],
    ),
    (1, 0, 1): (
        0.710000, [1, 0.5, 0.5, 0.1], [0.29, -0.0275, 0.16],
        0.793482, [0.649213, 0.703314, 0.432809], [-0.144270, 0, -0.360674],
        0.361313, [0.059549, 0.670651, 0.200685], 0.360674, [0.360674, 0.450842, 0.360674],
    ),
    (0, 1, 1): (
        0.365000, [1, 1, 0.75, 0.15], [0.3175, -0.055, 0.24],
        0.829550, [0.667246, 0.685280, 0.288539], [0, -0.144270, -0.541011],
        0.738878, [0.357272, 0.540119, 0.217674], 0.180337, [0.631179, 0.180337, 0.180337],
    ),
}  # fmt: skip


def rays(count: int = 60, seed: int = 0):
    """(alpha, M) of random rays with 1–12 hits and mixed masks; then the extremes."""
    rng = np.random.default_rng(seed)
    for i in range(count):
        n = 1 + i % 12
        alpha = np.exp(rng.uniform(math.log(1 / 255), math.log(0.99), n))
        yield alpha, (rng.random(n) < 0.6).astype(float)
    for alpha in (0.99, 1 / 255):
        for masks in (np.ones(8), np.zeros(8), np.arange(8.0) % 2):
            yield np.full(8, alpha), masks


def tensors(*arrays) -> list[torch.Tensor]:
    """Float64 leaves."""
    return [torch.tensor(a, dtype=torch.float64, requires_grad=True) for a in arrays]


def one_ray_F(alpha, M, kind: str, **options) -> torch.Tensor:
    """F of the rasterizer's own compositing for one ray."""
    nothing = torch.zeros(len(alpha), dtype=torch.float64)
    hit = torch.ones(1, len(alpha), dtype=torch.bool)
    images = ref.blend(
        alpha[None],
        hit,
        M,
        nothing[:, None].expand(-1, 3),
        nothing,
        torch.zeros(3),
        mask_kind=kind,
        **options,
    )
    return images[3][0]


def test_closed_form_is_the_papers_sum():
    for alpha, M in rays():
        assert g.closed_F(alpha, M) == pytest.approx(g.paper_F(alpha, M), abs=1e-14)  # worst seen 9e-16


def test_closed_gradient_is_the_printed_gradient():
    for alpha, M in rays():
        # worst seen 1e-16
        np.testing.assert_allclose(g.closed_dF_dM(alpha, M), g.paper_dF_dM(alpha, M), atol=1e-14)


@pytest.mark.parametrize("kind", FORMS)
def test_printed_gradient_is_autograd(kind):
    value, printed = FORMS[kind]
    for alpha, M in rays():
        a, m = tensors(alpha, M)
        value(a, m).backward()
        np.testing.assert_allclose(m.grad, printed(alpha, M), rtol=1e-11, atol=1e-13)


@pytest.mark.parametrize("kind", FORMS)
def test_printed_gradient_is_the_finite_difference(kind):
    value, printed = FORMS[kind]
    for alpha, M in rays(24):
        difference = g.central_difference(lambda m, a=alpha: value(a, m), torch.tensor(M))
        np.testing.assert_allclose(difference, printed(alpha, M), rtol=1e-6, atol=1e-9)  # worst seen 5e-10


@pytest.mark.parametrize("kind", FORMS)
def test_rasterizer_gives_the_printed_mask_and_gradient(kind):
    value, printed = FORMS[kind]
    for alpha, M in rays():
        a, m = tensors(alpha, M)
        F = one_ray_F(a, m, kind)
        F.backward()
        assert F.item() == pytest.approx(value(alpha, M), abs=1e-13)
        np.testing.assert_allclose(m.grad, printed(alpha, M), rtol=1e-11, atol=1e-13)


def test_alpha_gradient():
    for alpha, M in rays():
        a, m = tensors(alpha, M)
        g.paper_F(a, m).backward()
        np.testing.assert_allclose(a.grad, g.closed_dF_dalpha(alpha, M), atol=1e-12)
        assert (a.grad <= 1e-15).all()


def test_self_form_holds_the_transmittance_constant():
    for alpha, M in rays():
        a, m = tensors(alpha, M)
        one_ray_F(a, m, "svr", mask_gradient="self").backward()
        np.testing.assert_allclose(m.grad, g.self_dF_dM(alpha, M), atol=1e-14)


def test_gradient_is_positive_and_at_most_one_over_log_count():
    for alpha, M in rays():
        gradient = np.array(g.closed_dF_dM(alpha, M))
        assert (gradient > 0).all() and (gradient <= 1 / math.log(1 + len(alpha))).all()


def test_exact_gradient_hardly_differs_along_an_opaque_ray():
    alpha, M = np.tile([0.5, 0.05], 20), np.ones(40)
    exact, alone = np.array(g.closed_dF_dM(alpha, M)), np.array(g.self_dF_dM(alpha, M))
    assert np.ptp(exact) < 1e-5 < 0.1 < np.ptp(alone)


@pytest.mark.parametrize("kind", FORMS)
def test_empty_ray(kind):
    value, printed = FORMS[kind]
    assert value([], []) == 0 and printed([], []) == []
    a, m = tensors([0.5], [1.0])
    nothing = torch.zeros(1, 1, dtype=torch.bool)
    F = ref.spatial_mask(0 * a[None], m, ref.transmittance(0 * a[None], m)[:, :-1], nothing, kind, 1e-3)
    (F.sum() + 0 * a.sum()).backward()
    assert F.item() == 0 and m.grad.item() == 0 and a.grad.item() == 0


def test_scenario_a_is_one_where_every_gaussian_exists():
    for alpha, _ in rays(24):
        assert g.scenario_a_F(alpha, np.ones(len(alpha))) == pytest.approx(1, abs=1e-14)


@pytest.mark.parametrize("M", VECTORS)
def test_vectors(M):
    C, T, dC, F, dF, dF_da, F_A, dF_A, F_B, dF_B = VECTORS[M]
    close = {"rtol": 0, "atol": 5.1e-7}  # half a unit of the last decimal
    np.testing.assert_allclose(g.colour(ALPHA, M, COLOUR, BACKGROUND), C, **close)
    np.testing.assert_allclose(g.transmittances(ALPHA, M), T, **close)
    np.testing.assert_allclose(g.dC_dM(ALPHA, M, COLOUR, BACKGROUND), dC, **close)
    for value, gradient in ((g.paper_F, g.paper_dF_dM), (g.closed_F, g.closed_dF_dM)):
        np.testing.assert_allclose(value(ALPHA, M), F, **close)
        np.testing.assert_allclose(gradient(ALPHA, M), dF, **close)
    np.testing.assert_allclose(g.closed_dF_dalpha(ALPHA, M), dF_da, **close)
    np.testing.assert_allclose(g.scenario_a_F(ALPHA, M), F_A, **close)
    np.testing.assert_allclose(g.scenario_a_dF_dM(ALPHA, M), dF_A, **close)
    np.testing.assert_allclose(g.scenario_b_F(ALPHA, M), F_B, **close)
    np.testing.assert_allclose(g.scenario_b_dF_dM(ALPHA, M), dF_B, **close)


def test_colour_gradients_are_autograd_for_both_mask_values():
    rng = np.random.default_rng(1)
    for alpha, M in rays():
        c = rng.random(len(alpha))
        a, m = tensors(alpha, M)
        g.colour(a, m, c, 0.3).backward()
        np.testing.assert_allclose(m.grad, g.dC_dM(alpha, M, c, 0.3), atol=1e-13)
        np.testing.assert_allclose(a.grad, g.dC_dalpha(alpha, M, c, 0.3), atol=1e-13)


def test_colour_gradient_is_the_exact_difference_of_existing():
    """C is linear in each mask, so its derivative is C(M_i = 1) − C(M_i = 0), whichever was drawn."""
    rng = np.random.default_rng(2)
    for alpha, M in rays(24):
        c = rng.random(len(alpha))
        for i, gradient in enumerate(g.dC_dM(alpha, M, c, 0.3)):
            on, off = M.copy(), M.copy()
            on[i], off[i] = 1, 0
            assert gradient == pytest.approx(
                g.colour(alpha, on, c, 0.3) - g.colour(alpha, off, c, 0.3), abs=1e-14
            )


def test_masked_equals_deleted():
    rng = np.random.default_rng(3)
    for alpha, M in rays():
        c, kept = rng.random(len(alpha)), M == 1
        full, short = (alpha, M, c, 0.3), (alpha[kept], M[kept], c[kept], 0.3)
        assert g.colour(*full) == pytest.approx(g.colour(*short), abs=1e-15)
        assert g.transmittances(*full[:2])[-1] == g.transmittances(*short[:2])[-1]
        for gradient in (g.dC_dM, g.dC_dalpha):
            np.testing.assert_allclose(np.array(gradient(*full))[kept], gradient(*short), atol=1e-15)
        assert not np.array(g.dC_dalpha(*full))[~kept].any()
