"""Saliency of a Gaussian; `--method removal` and `saliency`: passes that remove the lowest."""

import json
import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import prune_settings, train_settings
from short_runs import counts_of
from svrgs_addon.finetune import settings
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import removal
from svrgs_addon.finetune.methods.removal import FEWEST, PASSES, STEPS_PER_PASS, number_of_passes
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.saliency import SHARE, removal_errors, saliency, views_that_see
from svrgs_addon.finetune.settings import Rates, rates_for
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.system.errors import SceneError

COUNT = 60


def scene_and_data(count: int = COUNT):
    scene = scenes.random_scene(count, 2, 1, scale=0.25)
    return scene, photographed(scene)


def run_of(settings, count: int = COUNT) -> Run:
    scene, data = scene_and_data(count)
    return Run(Model.of(scene), data, settings, NativeEngine())


def test_saliency_is_the_removal_error_over_the_mask_penalty():
    """One view, not made smaller, and renders that really leave each Gaussian out."""
    scene = scenes.random_scene(30, 5, 1, scale=0.3)
    scene.opacity_logits[:] = np.minimum(scene.opacity_logits, -1.0)  # no ray stops
    camera = scenes.camera(41, 31)
    r, options = Rasterizer("float64"), RenderOptions(mask_kind="svr")
    double = Model.of(scene, np.float64)
    found = saliency(ViewedScene(double, [camera], r, options))
    whole = {
        name: image.copy()
        for name, image in r.forward(double, camera, options, outputs=("rgb", "mask", "hits")).items()
    }
    for i in range(scene.count):
        masks = np.ones(scene.count, np.uint8)
        masks[i] = 0
        without = r.forward(double, camera, options, masks, ("rgb", "mask"))
        change = whole["mask"] - without["mask"]  # F is linear: dF/dM times 1
        pixels = change > 0
        if not pixels.any():
            assert found[i] == 0
            continue
        removal_error = ((whole["rgb"] - without["rgb"]) ** 2).mean()
        mask_penalty = SHARE * (2 * whole["mask"] * change).sum() / pixels.sum()
        assert found[i] == pytest.approx(removal_error / mask_penalty, rel=1e-9)


def test_as_many_stay_as_have_a_saliency_above_lambda():
    look = run_of(prune_settings("removal", 40, 0))
    value = np.sort(saliency(look.viewed))
    limit = float(value[COUNT - 23 : COUNT - 21].mean())  # between the 22nd and the 23rd
    assert counts_of(run_of(prune_settings("removal", 40, 5, lambda_f=limit)))[-1] == 22


def test_more_steps_than_were_measured_are_trusted_with_no_more():
    floor = lambda steps: removal.floor_of_drop(30, prune_settings("removal", 0, steps, max_loss=1.0))
    assert floor(400) > floor(800) == floor(8_000)


def test_what_is_protected_counts_whatever_its_saliency():
    run = run_of(prune_settings("removal", 16, 0, own=(0, 10), lambda_f=1e12))
    assert run.method.budget(run) == COUNT - 10


def test_a_lambda_above_every_saliency_is_refused_at_once():
    run = run_of(prune_settings("removal", 40, 0, lambda_f=1e12))
    with pytest.raises(SceneError, match="use a smaller lambda-f"):
        run.advance()
    run.close()
    assert run.iteration == 0


def test_those_of_lowest_removal_error_go_first(monkeypatch):
    monkeypatch.setattr(settings, "USUAL_STEPS", 1)
    monkeypatch.setattr(removal, "STEPS_PER_PASS", 2)
    monkeypatch.setattr(removal, "lowering", lambda steps: (1.0, 1.0))
    run = run_of(replace(prune_settings("removal", 32, 0), target=15))
    run.advance()  # one step, and the first pass
    left = set(run.model.origin)
    run.close()
    other = run_of(replace(prune_settings("3dgs", 0, 1)))
    other.advance()  # the same step, at another rate of the opacities
    errors = removal_errors(other.viewed)
    other.close()
    lowest = other.model.origin[np.argsort(errors)[: COUNT - len(left)]]
    assert 0 < len(lowest) < COUNT / 2 and len(left & set(lowest)) <= 1


@pytest.mark.parametrize("method", ["removal", "saliency"])
def test_the_target_is_approached_quickly_at_first_and_met(method, monkeypatch):
    monkeypatch.setattr(removal, "STEPS_PER_PASS", 2)
    counts = counts_of(run_of(replace(prune_settings(method, 32, 4), target=15)))
    np.testing.assert_allclose(
        counts[:32:2], [COUNT * (15 / COUNT) ** math.sqrt(k / PASSES) for k in range(1, PASSES + 1)], atol=1
    )
    # a pass after the first step of each part
    assert counts[0] == counts[1] and counts[30] == counts[-1] == 15


def test_a_short_run_takes_larger_steps_and_a_long_one_those_of_3dgs():
    for steps, larger in ((12_800, 1), (3_200, 2), (800, 4), (100, 4)):
        first, recover = (
            phase.rates.at(1, 1.0)
            for phase in prune_settings("removal", steps * 3 // 8, steps * 5 // 8).phases
        )
        usual = Rates().at(0, 1.0)
        for name in ("log_scales", "quats", "sh", "sh_rest"):
            assert first[name] == recover[name] == pytest.approx(larger * usual[name], rel=1e-3)
        assert first["means"] == pytest.approx(min(larger, 2) * usual["means"])
        assert recover["means"] == pytest.approx(first["means"], rel=0.1)
        assert (first["opacity_logits"], recover["opacity_logits"]) == (0.025, 0.05)


@pytest.mark.parametrize(("left", "larger"), [(60, 1), (15, 1), (5, 3**0.5), (1, 15**0.5)])
def test_the_fewer_are_left_the_larger_the_steps(left, larger):
    run = run_of(replace(prune_settings("removal", 12_800, 12_800), target=15))
    run.method.count = COUNT
    run.model.keep(np.arange(COUNT) < left)
    for phase in run.plan.phases:
        usual, rates = phase.rates.at(7, run.extent), run.method.rates(run, phase, 7)
        for name in ("log_scales", "quats", "sh", "sh_rest"):
            assert rates[name] == pytest.approx(larger * usual[name])
        assert rates["means"] == pytest.approx(min(larger, 2) * usual["means"])
        assert rates["opacity_logits"] == usual["opacity_logits"]


def test_steps_are_never_larger_than_four_times_those_of_3dgs():
    run = run_of(replace(prune_settings("removal", 40, 40), target=15))
    run.method.count = COUNT
    run.model.keep(np.arange(COUNT) < 5)
    assert run.method.rates(run, run.plan.phases[0], 1) == run.plan.phases[0].rates.at(1, run.extent)


def test_training_keeps_its_rates_until_gaussians_are_removed():
    train, *_ = train_settings("removal", 3_000, 500).phases
    assert train.rates == rates_for(train.steps, Rates(position_steps=3_000))


def test_a_short_phase_has_fewer_passes():
    counts = counts_of(run_of(replace(prune_settings("removal", 32, 4), target=15)))
    assert len(set(counts)) == FEWEST < PASSES and counts[-1] == 15
    assert [
        number_of_passes(steps) for steps in (1, FEWEST, 8 * STEPS_PER_PASS, PASSES * STEPS_PER_PASS, 10_000)
    ] == [1, FEWEST, 8, PASSES, PASSES]


@pytest.mark.parametrize("steps", [1, 5, 17])
def test_a_short_phase_meets_the_target_too(steps):
    assert counts_of(run_of(replace(prune_settings("removal", steps, 2), target=15)))[-1] == 15


def test_a_target_above_the_count_prunes_nothing():
    assert counts_of(run_of(replace(prune_settings("removal", 8, 0), target=1_000)))[-1] == COUNT


def test_nothing_but_the_image_loss_acts_on_those_that_stay():
    run = run_of(replace(prune_settings("removal", 32, 0), target=15))
    phase, number = run.phase()
    run._prepare(phase, number)
    assert run.method.terms(run, phase, number) == {}
    run.close()


@pytest.mark.parametrize(
    ("steps", "factor", "odds"),
    [
        (0, 1, 1),
        (30, 1, 0.1**0.5),
        (60, 1, 0.1),
        (240, 0.5, 0.1),
        (960, 0.25, 0.1),
        (6_000, 0.1, 0.1),
        (100_000, 0.1, 0.1),
    ],
)
def test_the_more_steps_can_raise_opacities_the_lower_they_begin(steps, factor, odds):
    assert removal.lowering(steps) == pytest.approx((factor, odds))


def test_opacities_are_lowered_before_the_first_step_but_not_of_what_no_view_sees():
    scene, data = scene_and_data()
    scene.means[:3] += 1_000
    run = Run(Model.of(scene), data, replace(prune_settings("removal", 240, 0), target=15), NativeEngine())
    seen = views_that_see(run.viewed)
    assert not seen[:3].any() and seen[3:].all()
    run._prepare(*run.phase())
    before, after = (
        1 / (1 + np.exp(-values.astype(float))) for values in (scene.opacity_logits, run.model.opacity_logits)
    )
    run.close()
    factor, odds = removal.lowering(240 * seen.mean() / len(run.training_cameras))
    assert 0.4 < factor < 0.7 and odds == 0.1
    lower = factor * before[3:]
    np.testing.assert_allclose(after[3:] / (1 - after[3:]), odds * lower / (1 - lower), rtol=1e-5)
    np.testing.assert_array_equal(run.model.opacity_logits[:3], scene.opacity_logits[:3])


@pytest.mark.parametrize(("steps", "soon"), [(8_000, 150), (200, 100)])
def test_lowered_opacities_may_rise_faster_at_first(steps, soon):
    run = run_of(replace(prune_settings("removal", steps, 0), target=15))
    phase, _ = run.phase()
    last = phase.rates.at(1, 1.0)["opacity_logits"]
    for lowered, factors in ((True, [8 - 7 / soon, 4.5, 1, 1]), (False, [1, 1, 1, 1])):
        run.method.lowered = lowered
        found = [
            run.method.rates(run, phase, number)["opacity_logits"] / last
            for number in (1, soon // 2, soon, steps)
        ]
        assert found == pytest.approx(factors)
    run.close()


@pytest.mark.parametrize(
    ("opaque", "more", "lowered"),
    [(3, {"target": 15}, True), (2, {"target": 15}, False), (3, {"max_loss": 1.0}, True)],
)
def test_nothing_is_lowered_where_few_gaussians_are_opaque(opaque, more, lowered):
    scene, data = scene_and_data()
    scene.opacity_logits[:] = np.where(np.arange(COUNT) < opaque, 2.2, 2.1)  # opacities 0.900 and 0.891
    run = Run(Model.of(scene), data, replace(prune_settings("removal", 32, 0), **more), NativeEngine())
    run._prepare(*run.phase())
    run.close()
    assert run.method.lowered is json.loads(json.dumps(run.method.state()))["lowered"] is lowered
    assert (run.model.opacity_logits == scene.opacity_logits).all() != lowered


def test_only_the_first_step_lowers_opacities():
    run = run_of(replace(prune_settings("removal", 32, 0), target=15))
    before = run.model.opacity_logits.copy()
    phase, _ = run.phase()
    run.method.prepare(run, phase, 2)
    run.close()
    np.testing.assert_array_equal(run.model.opacity_logits, before)


def test_no_more_is_lost_than_allowed():
    scene, data = scene_and_data()
    scene.sh[:] += np.random.default_rng(1).normal(0, 0.1, scene.sh.shape)  # something to lose against
    run = Run(Model.of(scene), data, replace(prune_settings("removal", 32, 0), max_loss=1.0), NativeEngine())
    before = run.quality(None)
    assert counts_of(run)[-1] < COUNT
    assert 10 < before - 1.0 <= run.quality(None)


def test_in_training_removal_comes_after_densification():
    phases = train_settings("removal", 23, 5, target=30).phases
    assert [(phase.name, phase.steps, phase.active) for phase in phases] == [
        ("train", 15, False),
        ("prune", 8, True),
        ("recover", 5, False),
    ]
    counts = counts_of(run_of(train_settings("removal", 23, 5, target=30)))
    assert counts[14] == COUNT > counts[15] > counts[22] == counts[-1] == 30
