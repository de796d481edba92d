"""Densification of 3DGS-MCMC: relocation, growth, noise and penalties, rule by rule; runs with it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import train_settings
from short_runs import bits, disturbed, logit, to_the_end
from svrgs_addon.finetune import checkpoint, mcmc
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.penalties import MeanOpacity, MeanScale
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import MCMC, Densify
from svrgs_addon.finetune.torch_engine import TorchEngine
from svrgs_addon.prune.options import TrainOptions
from svrgs_addon.prune.plans import plan_of_training
from svrgs_addon.scene.rotations import rotated, rotation_matrices
from svrgs_addon.system.errors import SceneError

RULE = MCMC(cap=10_000)


def gaussians(opacities) -> Model:
    """Gaussians with existence logits and with moments of 1 everywhere."""
    model = Model.of(scenes.random_scene(len(opacities), sh_degree=1))
    model.add_masks(3.0)
    model.opacity_logits[:] = [logit(p) for p in opacities]
    for array in model.moments.values():
        array[:] = 1
    return model


def rng(seed: int = 0) -> np.random.Generator:
    return np.random.default_rng(seed)


# --- shares of one Gaussian


@pytest.mark.parametrize("count", [1, 2, 3, 7, 50])
@pytest.mark.parametrize("opacity", [0.006, 0.3, 0.95, 0.9999])
def test_shares_are_those_of_the_printed_double_sum(opacity, count):
    share = 1 - (1 - opacity) ** (1 / count)
    total = sum(
        math.comb(i - 1, k) * (-1) ** k * share ** (k + 1) / math.sqrt(k + 1)
        for i in range(1, count + 1)
        for k in range(i)
    )
    found = mcmc.shares(np.array([opacity]), np.array([count]))
    np.testing.assert_allclose([x[0] for x in found], [share, opacity / total], rtol=1e-9)


def test_more_than_50_share_a_place_as_50_do():
    np.testing.assert_array_equal(
        mcmc.shares(np.array([0.5]), np.array([51])), mcmc.shares(np.array([0.5]), np.array([50]))
    )


def test_together_they_are_as_opaque_at_the_centre_and_as_much_in_all():
    """At the centre 1 - (1 - share)^n is the old opacity; along a line through it the integral of alpha is
    the old one (the rule's aim)."""
    x = np.linspace(-12, 12, 200_001)
    for opacity, count in ((0.7, 2), (0.4, 5)):
        (share,), (scale,) = mcmc.shares(np.array([opacity]), np.array([count]))
        together = 1 - (1 - share * np.exp(-0.5 * (x / scale) ** 2)) ** count
        assert together.max() == pytest.approx(opacity)
        assert together.sum() == pytest.approx((opacity * np.exp(-0.5 * x**2)).sum(), rel=1e-6)


# --- relocation and growth


def test_the_dead_move_onto_the_living():
    model = gaussians([0.004, 0.5, 0.0049, 0.8, 0.9])
    before = {name: array.copy() for name, array in model.values.items()}
    assert mcmc.densify(model, replace(RULE, cap=5), rng()) == 2 and model.count == 5
    hosts = [next(j for j in (1, 3, 4) if (model.means[i] == before["means"][j]).all()) for i in (0, 2)]
    for array in model.values.values():
        np.testing.assert_array_equal(array[[0, 2]], array[hosts])
    untouched = sorted({1, 3, 4} - set(hosts))
    assert untouched and (model.opacity_logits[untouched] == before["opacity_logits"][untouched]).all()
    for host in set(hosts):
        copies = 1 + hosts.count(host)
        (share,), (scale,) = mcmc.shares(np.array([[0, 0.5, 0, 0.8, 0.9][host]]), np.array([copies]))
        assert model.opacity_logits[host] == pytest.approx(logit(share), rel=1e-5)
        np.testing.assert_allclose(
            model.log_scales[host], before["log_scales"][host] + math.log(scale), rtol=1e-5
        )
        assert all((array[host] == 0).all() for array in model.moments.values())
    assert all(
        (array[untouched] == 1).all() and (array[[0, 2]] == 1).all() for array in model.moments.values()
    ), "only the hosts start again"


def test_hosts_are_drawn_in_proportion_to_opacity():
    model = gaussians([0.001] * 20_000 + [0.6] * 5_000 + [0.2] * 5_000)
    mcmc.densify(model, replace(RULE, cap=1), rng(3))
    places = {tuple(row): k for k, row in enumerate(model.means[20_000:])}
    drawn = np.array([places[tuple(row)] for row in model.means[:20_000]])
    assert (drawn < 5_000).mean() == pytest.approx(0.75, abs=5 * math.sqrt(0.75 * 0.25 / 20_000))


def test_the_scene_grows_by_a_twentieth_up_to_the_cap():
    model = gaussians([0.5] * 200)
    assert [mcmc.densify(model, replace(RULE, cap=225), rng(k)) for k in range(4)] == [10, 10, 5, 0]
    assert model.count == 225 and (model.origin[200:] == -1).all() and (model.values[MASK] == 3.0).all()
    assert mcmc.densify(gaussians([0.5] * 200), RULE, rng(), lambda n: False) == 0
    over = gaussians([0.5] * 20)
    assert mcmc.densify(over, replace(RULE, cap=5), rng()) == 0 and over.count == 20, "a cap removes nothing"


# --- noise and penalties


def test_noise_has_the_covariance_of_the_gaussian_and_fades_with_opacity():
    n, rate = 200_000, 1e-6
    for opacity in (0.001, 0.02):
        model = gaussians([opacity])
        quat, scales = model.quats[0].astype(np.float64), np.exp(model.log_scales[0].astype(np.float64))
        many = Model({name: np.repeat(array, n, axis=0) for name, array in model.values.items()})
        before = many.means.astype(np.float64)
        mcmc.add_noise(many, RULE, rate, rng(1))
        moved = many.means - before
        R = rotation_matrices(quat[None])[0]
        size = 5e5 * rate / (1 + math.exp(-100 * (0.005 - opacity)))
        expected = size**2 * R @ np.diag(scales**4) @ R.T  # Sigma n has the covariance Sigma^2
        np.testing.assert_allclose(moved.T @ moved / n, expected, atol=0.02 * expected.max())


def test_the_opaque_do_not_move():
    model = gaussians([0.3, 0.9])
    before = model.means.copy()
    mcmc.add_noise(model, RULE, 1.6e-4, rng())
    np.testing.assert_array_equal(model.means, before)


def test_vectors_are_turned_as_by_matrices():
    generator = rng(2)
    quats, vectors = generator.normal(size=(50, 4)), generator.normal(size=(50, 3))
    np.testing.assert_allclose(
        rotated(quats, vectors),
        np.einsum("nij,nj->ni", rotation_matrices(quats), vectors),
        rtol=1e-12,
        atol=1e-12,
    )


def mcmc_run(engine=None, dtype=np.float32, method: str = "3dgs", **rule) -> Run:
    """150 Gaussians that grow, some of them dead; then some steps without growth, then recovery."""
    truth = scenes.random_scene(150, 2, 1, scale=0.2, opacity=-3.0)
    growth = MCMC(start=5, until=31, every=10, cap=rule.pop("cap", 160))
    settings = train_settings(method, 40, 10, densify=growth, seed=4, **rule)
    return Run(Model.of(disturbed(truth), dtype), photographed(truth), settings, engine or NativeEngine())


def test_the_penalties_are_in_the_loss_of_every_step_of_training():
    run = mcmc_run()
    for number, phase in ((1, 0), (40, 0), (1, 1)):
        step = run._step(run.plan.phases[phase], number, run.dataset.cameras[0], None)
        assert step.penalties == ((MeanOpacity(0.01), MeanScale(0.01)) if phase == 0 else ())
    pruning = mcmc_run(method="compact3dgs")
    pruning._prepare(pruning.plan.phases[0], 1)
    assert len(pruning._step(pruning.plan.phases[0], 1, pruning.dataset.cameras[0], None).penalties) == 3


# --- runs


def test_a_run_grows_to_the_cap_and_stays_there():
    run, counts, moved = mcmc_run(), [], []
    while not run.finished:
        before = run.model.means.copy()
        run.advance()
        counts.append(run.model.count)
        moved.append(
            (run.model.means != before).any(axis=1).mean() if len(before) == run.model.count else 1.0
        )
    run.close()
    assert counts == [150] * 9 + [157] * 10 + [160] * 31
    assert all(share > 0.5 for share in moved[10:18]), "noise moves faint Gaussians in every step"


@pytest.mark.parametrize("iteration", [8, 10, 25, 35, 44])
def test_a_run_restored_from_a_checkpoint_goes_on_bit_for_bit(tmp_path, iteration):
    whole, first, second = mcmc_run(), mcmc_run(), mcmc_run()
    while first.iteration < iteration:
        first.advance()
    first.close()
    checkpoint.save(first, tmp_path, "same")
    assert checkpoint.restore(second, tmp_path, "same")
    assert bits(to_the_end(second).model) == bits(to_the_end(whole).model)


def test_both_engines_end_alike():
    """In float64. Worst seen: 4e-15 of the largest value."""
    native, torch_ = (
        to_the_end(mcmc_run(engine("float64"), np.float64)) for engine in (NativeEngine, TorchEngine)
    )
    assert native.model.count == 160
    for name, value in native.model.values.items():
        assert np.abs(value - torch_.model.values[name]).max() < 1e-12 * np.abs(value).max(), name


# gns ends growth at step 26
@pytest.mark.parametrize(("method", "grown"), [("svr", 172), ("gns", 164), ("lightgaussian", 172)])
def test_methods_prune_to_a_share_of_what_has_grown(method, grown):
    run = to_the_end(mcmc_run(method=method, share=0.5, cap=200))
    assert run.target == run.model.count == grown // 2


# --- options


def options(**more) -> TrainOptions:
    return TrainOptions(densify="mcmc", **more)


def test_the_cap_is_the_option_s_or_the_target_s():
    first = plan_of_training(options(cap=5_000)).phases[0].densify
    assert first == MCMC(until=25_000, cap=5_000) and first.INITIAL == (0.5, 0.1)
    plan = plan_of_training(options(target_count=7_000, iterations=600))
    assert plan.phases[0].densify == MCMC(start=166, until=500, cap=7_000) and plan.target == 0
    pruning = plan_of_training(options(target_count=7_000, cap=20_000, method="gns"))
    assert pruning.phases[0].densify.cap == 20_000 and pruning.target == 7_000
    assert plan_of_training(TrainOptions()).phases[0].densify == Densify()
    with pytest.raises(SceneError, match="--densify mcmc needs --cap N"):
        plan_of_training(options())
    with pytest.raises(SceneError, match="--densify mcmc needs --cap N"):
        plan_of_training(options(target_count=7_000, method="gns"))
    with pytest.raises(SceneError, match="--cap limits the growth of --densify mcmc"):
        plan_of_training(TrainOptions(cap=5_000))


def test_a_shorter_schedule_shortens_growth():
    rule = plan_of_training(options(cap=5_000, schedule=0.1)).phases[0].densify
    assert (rule.start, rule.until, rule.every, rule.cap) == (500, 2_500, 100, 5_000)


def test_gaussians_that_share_a_place_stay_alive():
    model, rule = gaussians([0.006] * 3), MCMC()
    mcmc._share(model, rule, np.zeros(40, int))
    assert model.opacity_logits[0] == pytest.approx(logit(rule.min_opacity))
