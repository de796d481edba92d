"""3DGS densification, rule by rule."""

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from short_runs import bits, logit
from svrgs_addon.finetune import densify
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.settings import MCMC, Densify

RULE = Densify()
EXTENT = 10.0  # so that Gaussians up to 0.1 are small


def gaussians(scales, opacity: float = 0.5, quats=None) -> Model:
    """Isotropic Gaussians at (row, 0, 0) with masks, and moments of 1 everywhere."""
    n = len(scales)
    model = Model.of(scenes.random_scene(n, sh_degree=1))
    model.add_masks(3.0)
    model.means[:] = np.arange(n)[:, None] * (1, 0, 0)
    model.log_scales[:] = np.log(np.asarray(scales, float).reshape(n, -1))
    model.opacity_logits[:] = logit(opacity)
    if quats is not None:
        model.quats[:] = quats
    for array in model.moments.values():
        array[:] = 1
    return model


def pulled(gradients, views=1) -> densify.Statistics:
    """Statistics with these mean gradients."""
    statistics = densify.Statistics(len(gradients))
    statistics.total[:] = np.asarray(gradients) * views
    statistics.views[:] = views
    return statistics


def grow(model: Model, statistics: densify.Statistics, rule: Densify = RULE, seed: int = 0) -> np.ndarray:
    return densify.densify(model, statistics, rule, EXTENT, np.random.default_rng(seed))


def test_gradients_are_averaged_over_the_views_that_saw_the_gaussian():
    """Norms in units of half the image; a Gaussian never seen has mean 0, not 0/0."""
    statistics = densify.Statistics(4)
    statistics.add(np.array([0, 2], np.uint32), np.array([[3e-4, 0], [3e-5, 4e-5]], np.float32), 20, 20)
    statistics.add(np.array([0], np.uint32), np.array([[0, 2e-4]], np.float32), 30, 10)
    np.testing.assert_allclose(statistics.mean(), [(3e-3 + 1e-3) / 2, 0, 5e-4, 0], rtol=1e-6)


def test_only_gaussians_at_the_threshold_or_above_multiply():
    model = gaussians([0.05] * 4)
    stays = grow(model, pulled([1.9e-4, RULE.gradient * 1.0001, 0, 1e-3]))
    assert model.count == 6 and stays.all()
    np.testing.assert_array_equal(model.means[4:, 0], [1, 3])


def test_small_gaussians_are_cloned_where_they_are():
    """Up to 0.01 of the extent: exact copies, masks too; only the moments start at zero."""
    model = gaussians([0.099, 0.05])
    before = {name: value.copy() for name, value in model.values.items()}
    assert grow(model, pulled([1e-3, 0])).all()
    for name, value in model.values.items():
        np.testing.assert_array_equal(value[:2], before[name])
        np.testing.assert_array_equal(value[2], before[name][0])
        assert (model.moments[name][:2] == 1).all() and (model.moments[name][2:] == 0).all()
    assert model.origin.tolist() == [0, 1, -1]


def test_large_gaussians_are_split_in_two_and_go():
    """Above 0.01 of the extent: children 1.6 times smaller, otherwise like the parent; the largest axis
    decides."""
    model = gaussians([[0.05, 0.05, 0.05], [0.02, 0.101, 0.02], [0.5, 0.5, 0.5]])
    parent = {name: value[1].copy() for name, value in model.values.items()}
    stays = grow(model, pulled([0, 1e-3, 0]))
    assert stays.tolist() == [True, False, True, True, True]
    children = {name: value[3:] for name, value in model.values.items()}
    np.testing.assert_allclose(
        np.exp(children["log_scales"]), np.tile([0.0125, 0.063125, 0.0125], (2, 1)), rtol=1e-5
    )
    for name in ("quats", "opacity_logits", "sh", MASK):
        np.testing.assert_array_equal(children[name], np.stack([parent[name]] * 2))
    assert all((model.moments[name][3:] == 0).all() for name in model.values)
    assert (children["means"][0] != children["means"][1]).any()


def test_children_are_drawn_from_their_parents_own_gaussian():
    """A needle along its x axis, turned by 60 degrees about z: children lie on its line, spread as it is."""
    scale, angle = 0.5, math.pi / 3
    model = gaussians(
        [[0.2] * 3, [scale, 1e-6, 2e-6]], quats=[3 * math.cos(angle / 2), 0, 0, 3 * math.sin(angle / 2)]
    )
    grow(model, pulled([0, 1]), replace(RULE, split_into=4_000))
    offsets = model.means[2:] - (1, 0, 0)
    along = offsets @ (math.cos(angle), math.sin(angle), 0)
    np.testing.assert_allclose(offsets, along[:, None] * (math.cos(angle), math.sin(angle), 0), atol=1e-4)
    assert along.std() == pytest.approx(scale, rel=0.04)
    assert along.mean() == pytest.approx(0, abs=4 * scale / math.sqrt(4_000))


def test_growth_depends_on_the_seed_alone():
    first, second, other = (gaussians([0.5] * 6) for _ in range(3))
    for model, seed in ((first, 0), (second, 0), (other, 1)):
        grow(model, pulled([1e-3] * 6), seed=seed)
    assert bits(first) == bits(second) != bits(other)


def test_nothing_grows_where_nothing_pulls():
    model = gaussians([0.5, 0.05])
    before = bits(model)
    assert grow(model, pulled([0, 0], views=0)).tolist() == [True, True]
    assert bits(model) == before


def test_faint_gaussians_are_not_kept():
    model = gaussians([0.1] * 4)
    model.opacity_logits[:] = [logit(p) for p in (0.0049, 0.0051, 0.9, 1e-6)]
    assert densify.keep_mask(model, RULE, EXTENT, after_reset=False).tolist() == [False, True, True, False]


def test_huge_gaussians_go_once_opacities_were_reset():
    model = gaussians([[0.99] * 3, [0.1, 0.1, 1.01], [0.01, 50, 0.01]])
    assert densify.keep_mask(model, RULE, EXTENT, after_reset=False).all()
    assert densify.keep_mask(model, RULE, EXTENT, after_reset=True).tolist() == [True, False, False]


def test_opacities_are_reset_to_a_hundredth_at_most():
    model = gaussians([0.1] * 3)
    model.opacity_logits[:] = [logit(p) for p in (0.9, 0.01, 0.006)]
    before = {name: value.copy() for name, value in model.values.items()}
    densify.reset_opacity(model)
    np.testing.assert_allclose(1 / (1 + np.exp(-model.opacity_logits)), [0.01, 0.01, 0.006], rtol=1e-5)
    for name in model.values:
        moved = name == "opacity_logits"
        assert moved or (model.values[name] == before[name]).all()
        assert (model.moments[name] == (0 if moved else 1)).all()


def test_opacities_and_then_their_odds_are_lowered_by_their_factors():
    model = gaussians([0.1] * 5)
    model.opacity_logits[:] = [logit(0.9), logit(0.02), 60.0, -60.0, 3.0]
    rows = np.array([True, True, True, True, False])
    densify.lower_opacity(model, rows, 0.5, 0.1)
    lowered = [logit(0.45), logit(0.01), logit(0.5), -60 + np.log(0.5)]
    np.testing.assert_allclose(model.opacity_logits, [*(np.log(0.1) + lowered), 3.0], rtol=1e-6)
    assert (model.moments["opacity_logits"] == 0).all() and (model.moments["means"] == 1).all()
    before = model.opacity_logits.copy()
    densify.lower_opacity(model, rows, 1.0, 1.0)
    np.testing.assert_allclose(model.opacity_logits, before, rtol=1e-6)


def test_growth_to_a_cap_ends_after_five_sixths_and_at_step_25_000():
    assert [MCMC.capped(9, steps).until for steps in (6_000, 60_000)] == [5_000, 25_000]
