"""Every method: its name, the share it keeps, its checkpoints, and that both engines end alike."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import LEARNED, RANKED, prune_settings, train_settings
from short_runs import bits, disturbed, to_the_end
from svrgs_addon.finetune import checkpoint
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, method_named, paper_method
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.finetune.torch_engine import TorchEngine
from svrgs_addon.system.errors import SceneError

# one of each class
FAMILIES = tuple({type(METHODS[name]): name for name in (*METHODS, "svr", "maskgs-alpha")}.values())


def state(run: Run) -> dict:
    return bits(run.model) | {"method": run.method.state(), "target": run.target, "loss": run.loss}


def grown_run(method: str, engine=None, dtype=np.float32, **changes) -> Run:
    """From a disturbed scene of 150: clones, splits, an opacity reset, pruning to about a third, recovery."""
    truth = scenes.random_scene(150, 2, 1, scale=0.2)
    rule = Densify(start=5, until=31, every=10, reset_every=25, gradient=2e-5, small=0.1)
    share = 0.0 if method == "3dgs" else 0.35
    settings = train_settings(method, 60, 10, densify=rule, seed=4, share=share)
    start = {} if method == "compact3dgs" else {"mask_init": 1.0}  # undecided masks, so that events bite
    phases = tuple(replace(phase, prune_every=phase.prune_every and 10) for phase in settings.phases)
    plan = replace(settings, phases=phases, **start, **changes)
    return Run(Model.of(disturbed(truth), dtype), photographed(truth), plan, engine or NativeEngine())


# --- the registry


def test_an_unknown_method_is_one_sentence():
    with pytest.raises(SceneError, match="method 'magic' is unknown: choose one of removal, svr, .*3dgs$"):
        method_named("magic")


def test_methods_of_two_runs_do_not_share_their_state():
    first, second = method_named("gns"), method_named("gns")
    first.factor = 7.0
    assert (second.factor, METHODS["gns"].factor) == (1.0, 1.0)


def test_paper_chooses_the_printed_settings_to_the_letter():
    """L1 + (1 - SSIM) with weights of 1, lambda_F 1e-4, F along the whole ray, 10 draws at each densification
    and every 1000 steps, no first cut."""
    paper = paper_method()
    assert (paper.mask_kind, paper.lambda_f, paper.first_cut) == ("svr", 1e-4, False)
    plan = train_settings("svr-paper", 30_000, 5_000)
    assert (plan.l1_weight, plan.ssim_weight) == (1.0, 1.0)
    assert (plan.lambda_f, plan.full, plan.mask_init, plan.draws) == (1e-4, True, 9.0, 10)
    assert plan.phases[0].prune_every == 1_000 and plan.phases[1].steps == 5_000
    svr = train_settings("svr", 30_000, 5_000)
    assert (svr.l1_weight, svr.ssim_weight, svr.method.first_cut) == (0.8, 0.2, True)
    assert svr.phases == plan.phases


def test_names_and_menu_numbers_are_each_one_method_s():
    """Numbers are stored in .blend files; the first ones never change."""
    assert len({method.number for method in METHODS.values()}) == len(METHODS)
    first = (
        "removal svr svr-self svr-even svr-a svr-b saliency maskgs maskgs-alpha maskgs-beta maskgs-gamma"
        " compact3dgs gns lightgaussian opacity contribution max-contribution pup"
    ).split()
    assert [METHODS[name].number for name in first] == list(range(len(first)))
    assert all(method.help and method.name == name for name, method in METHODS.items())


def test_a_weight_the_method_does_not_have_is_refused():
    with pytest.raises(SceneError, match="no term with the weight lambda-m"):
        prune_settings("svr", 10, 10, lambda_m=1e-3)
    assert prune_settings("compact3dgs", 10, 10, lambda_m=1e-3).lambda_m == 1e-3


# --- a share of what has grown


@pytest.mark.parametrize("method", [*RANKED, *LEARNED])
def test_a_share_counts_from_the_end_of_densification(method):
    run, grown = grown_run(method), 0
    while not run.finished:
        if run.iteration == 30:
            grown = run.model.count
        run.advance()
    run.close()
    # its soft cuts come while training densifies
    assert grown > 150 and run.target > 10 if method != "speedy" else run.target > 1
    if method in RANKED or method in ("gns", "speedy"):
        assert run.target == round(0.35 * grown) and run.model.count == run.target
    else:
        assert run.model.count <= run.target


# --- one map for all rows, and checkpoints


@pytest.mark.parametrize(
    "iteration", [pytest.param(8, marks=pytest.mark.slow), 33, pytest.param(47, marks=pytest.mark.slow), 62]
)
@pytest.mark.parametrize("method", FAMILIES)
def test_a_run_restored_from_a_checkpoint_goes_on_bit_for_bit(tmp_path, method, iteration):
    whole, first, second = grown_run(method), grown_run(method), grown_run(method)
    while first.iteration < iteration:
        first.advance()
    first.close()
    checkpoint.save(first, tmp_path, "same")
    assert checkpoint.restore(second, tmp_path, "same") and state(second) == state(first)
    assert state(to_the_end(second)) == state(to_the_end(whole))


@pytest.mark.parametrize("method", [name for name in LEARNED if METHODS[name].learns_masks])
def test_logits_follow_their_gaussians(method):
    """A logit that says which Gaussian it belongs to still does after clones, splits, a new order and an
    event."""
    run = grown_run(method)
    run.advance()
    rng = np.random.default_rng(0)
    run.model.values[MASK][:] = marks = rng.uniform(3, 4, run.model.count).astype(np.float32)
    run.model.sh[:, 0, 0] = marks  # a second copy, in an array that clones and splits leave alone
    run.model.moments[MASK][:] = 0
    before = run.model.count
    run.statistics.total[:], run.statistics.views[:] = 1.0, 1  # everything grows
    run._densify(run.plan.phases[0], 10, run.plan.phases[0].densify)
    run.model.reorder(rng.permutation(run.model.count))
    run.model.keep(rng.random(run.model.count) < 0.7)
    assert run.model.count != before and (run.model.origin == -1).any()
    np.testing.assert_array_equal(run.model.values[MASK], run.model.sh[:, 0, 0])
    run.close()


# --- engines


@pytest.mark.parametrize(
    "method",
    [
        pytest.param(name, marks=() if name in ("svr", "maskgs-alpha") else pytest.mark.slow)
        for name in FAMILIES
        if name in LEARNED
    ],
)
def test_every_learned_method_ends_alike_with_either_engine(method):
    """In float64, through growth, reset, pruning and recovery. Worst seen: 2.1e-14 of the largest value."""
    native, torch_ = (
        to_the_end(grown_run(method, engine("float64"), np.float64)) for engine in (NativeEngine, TorchEngine)
    )
    np.testing.assert_array_equal(native.model.origin, torch_.model.origin)
    assert native.method.state() == pytest.approx(torch_.method.state(), rel=1e-12)
    for name, value in native.model.values.items():
        assert np.abs(value - torch_.model.values[name]).max() < 1e-11 * np.abs(value).max(), name
