"""`--method pressure`: lambda_F gives the budget, pressure on opacities selects the Gaussians, the recovery uses dropout."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import prune_settings, train_settings
from svrgs_addon.errors import SceneError
from svrgs_addon.finetune import masks
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, pressure
from svrgs_addon.finetune.methods.pressure import LARGEST, WEIGHTS, pressure_weights
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.penalties import OpacityPressure
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.saliency import saliency
from svrgs_addon.finetune.settings import MAX_DROPOUT

COUNT = 60


def run_of(settings) -> Run:
    scene = scenes.random_scene(COUNT, 2, 1, scale=0.25)
    return Run(Model.of(scene), photographed(scene), settings, NativeEngine())


def to_the_end(run: Run) -> Run:
    while not run.finished:
        run.advance()
    run.close()
    return run


def test_as_many_stay_as_have_a_saliency_above_lambda():
    look = run_of(prune_settings("pressure", 40, 0))
    value = np.sort(saliency(look.model, look.training_cameras, look.engine.rasterizer, look.score_options))
    limit = float(value[COUNT - 23 : COUNT - 21].mean())  # between the 22nd and the 23rd
    assert to_the_end(run_of(prune_settings("pressure", 40, 5, lambda_f=limit))).model.count == 22


def test_a_lambda_above_every_saliency_is_refused_at_once():
    run = run_of(prune_settings("pressure", 40, 0, lambda_f=1e12))
    with pytest.raises(SceneError, match="use a smaller lambda-f"):
        run.advance()
    run.close()
    assert run.iteration == 0


def test_the_pressure_is_largest_where_the_removal_error_is_small():
    errors = np.array([4.0, 1.0, 0.25, 1e-9, 0.0])
    weights = pressure_weights(errors, 2)
    assert weights.mean() == pytest.approx(1) and (np.diff(weights[:4]) > 0).all() and weights[4] == weights[3]
    np.testing.assert_allclose(weights / weights[1], [0.5, 1, 2, LARGEST, LARGEST])


def test_few_photographs_give_every_gaussian_the_same_weight(monkeypatch):
    run = run_of(replace(prune_settings("pressure", 160, 0), target=20))
    views = len(run.training_cameras)
    assert views < pressure.FEW and weights_of(run) is None
    monkeypatch.setattr(pressure, "FEW", views)
    assert len(np.unique(weights_of(run))) > COUNT // 2


def weights_of(run):
    run._prepare(*run.phase())
    return run.method.gaussian_weights(run)


def test_weights_follow_their_gaussians(monkeypatch):
    monkeypatch.setattr(pressure, "FEW", 0)
    run = run_of(replace(prune_settings("pressure", 160, 0), target=20))
    for _ in range(21):  # removal errors every 16 pressed steps, each step pressed
        run.advance()
    before = dict(zip(run.model.origin, run.model.values[WEIGHTS], strict=True))
    run.model.keep(np.arange(run.model.count) % 2 == 0)
    run.model.reorder(np.arange(run.model.count)[::-1])
    run.close()
    assert len(set(before.values())) > COUNT // 2
    assert all(before[origin] == weight for origin, weight in zip(run.model.origin, run.model.values[WEIGHTS], strict=True))


@pytest.mark.parametrize("by_transparency", [False, True])
def test_gradient_of_an_uneven_pressure(by_transparency):
    rng = np.random.default_rng(0)
    logits, weights, h = rng.normal(0, 2, 12), rng.uniform(0.3, 3, 12), 1e-6
    pressure = OpacityPressure(0.7, by_transparency, weights)
    slopes = [(pressure.value(logits + h * e, np) - pressure.value(logits - h * e, np)) / (2 * h) for e in np.eye(12)]
    np.testing.assert_allclose(pressure.grad(logits), slopes, rtol=1e-6)


def test_most_of_the_recovery_uses_dropout_and_its_end_does_not():
    for settings in (prune_settings("pressure", 10, 50), train_settings("pressure", 30, 50)):
        recovery = settings.phases[-1]
        assert [recovery.dropout_rate(number, 60) for number in (1, 40, 41, 50)] == [0.1, 0.1, 0, 0]
        assert not any(phase.dropout for phase in settings.phases[:-1])
    left_out = [1 - masks.dropout_masks(10_000, 0.1, 3, step).mean() for step in range(20)]
    assert np.mean(left_out) == pytest.approx(0.1, abs=0.002) and len(set(left_out)) > 10


def test_the_fewer_views_the_more_dropout():
    recovery = prune_settings("pressure", 10, 50).phases[-1]
    rates = [recovery.dropout_rate(1, views) for views in (1, 20, 30, 60, 600)]
    assert rates == [MAX_DROPOUT, MAX_DROPOUT, 0.2, 0.1, 0.01]
    assert prune_settings("maskgs", 10, 50).phases[-1].dropout_rate(1, 20) == 0


def test_a_gaussian_that_is_left_out_does_not_change_in_that_step():
    run = run_of(prune_settings("3dgs", 0, 5))
    run.settings = replace(run.settings, phases=(replace(run.settings.phases[0], dropout=1e9),))
    here = masks.dropout_masks(COUNT, MAX_DROPOUT, run.settings.seed, 0)
    run._into_order()
    before = {name: value.copy() for name, value in run.model.values.items()}
    run.advance()
    run.close()
    for name, value in run.model.values.items():
        changed = (value != before[name]).reshape(COUNT, -1).any(axis=1)
        assert not changed[here == 0].any() and (name != "opacity_logits" or changed[here == 1].any())


def test_a_drop_is_held_by_method_saliency():
    assert prune_settings("pressure", 10, 5, max_drop=0.5).method.name == "saliency"
    assert prune_settings("maskgs", 10, 5, max_drop=0.5).method.name == "maskgs"


def test_pressed_steps_keep_their_distance_in_a_short_phase():
    def spacing(method: str, steps: int) -> int:
        return METHODS[method].press_every(prune_settings(method, steps, 0).phases[0])

    assert [spacing("pressure", steps) for steps in (8000, 800, 80)] == [50, 5, 4]
    assert [spacing("gns", steps) for steps in (8000, 800, 80)] == [50, 8, 8]
