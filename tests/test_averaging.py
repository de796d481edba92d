"""The mean of the values over the last steps of a phase: its value, the steps that count, removed Gaussians,
memory and disk."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import prune_settings
from short_runs import to_the_end
from svrgs_addon.finetune import averaging
from svrgs_addon.finetune.averaging import Average
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import SAMPLES, Phase, Rates
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system import memory

STEPS = 60  # of the recovery


def run_of(**changes) -> Run:
    scene = scenes.random_scene(60, 2, 1, scale=0.25)
    plan = replace(prune_settings("removal", 10, STEPS), target=20, **changes)
    return Run(Model.of(scene), photographed(scene), plan, NativeEngine())


def copied(model: Model) -> dict[str, np.ndarray]:
    return {name: getattr(model, name).astype(float) for name in PARAMETERS}


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_it_is_the_mean(monkeypatch, dtype):
    monkeypatch.setattr(averaging, "ROWS", 7)
    model, rng, average = Model.of(scenes.random_scene(30, 2, 1), dtype), np.random.default_rng(1), Average()
    seen = []
    for _ in range(20):
        for name in PARAMETERS:
            getattr(model, name)[:] += rng.normal(0, 0.1, getattr(model, name).shape)
        average.add(model)
        seen.append(copied(model))
    average.put_into(model)
    for name in PARAMETERS:
        reference = np.mean([values[name] for values in seen], axis=0)
        bound = 20 * np.finfo(dtype).eps * np.max([np.abs(values[name]) for values in seen], axis=0)
        assert getattr(model, name).dtype == dtype
        assert (np.abs(getattr(model, name) - reference) <= bound).all()


def test_values_that_do_not_change_stay_as_they_are():
    model, average = Model.of(scenes.random_scene(30, 2, 1)), Average()
    before = {name: getattr(model, name).copy() for name in PARAMETERS}
    for _ in range(9):
        average.add(model)
    average.put_into(model)
    assert all((getattr(model, name) == before[name]).all() for name in PARAMETERS)


@pytest.mark.parametrize("steps", [1, 3, 40, 500, 5_000])
def test_steps_that_count_are_spread_over_the_last_ones(steps):
    phase = Phase("recover", steps, Rates(), averaged=0.25)
    counted = [number for number in range(1, steps + 1) if phase.samples(number)]
    last = round(steps / 4)
    assert len(counted) == last if last <= SAMPLES else SAMPLES <= len(counted) < 2 * SAMPLES
    assert not counted or (
        counted[-1] == steps and counted[0] > steps - last and len(set(np.diff(counted))) <= 1
    )
    assert not any(replace(phase, averaged=0.0).samples(number) for number in range(1, steps + 1))


def test_a_run_ends_with_the_mean_of_the_recovery():
    run, plain = run_of(), run_of()
    plain.plan = replace(
        plain.plan, phases=tuple(replace(phase, averaged=0.0) for phase in plain.plan.phases)
    )
    seen = []
    while not run.finished:
        phase, number = run.phase()
        run.advance()
        plain.advance()
        if phase.samples(number):
            seen.append(copied(plain.model))
    assert len(seen) == STEPS // 4
    for name in PARAMETERS:
        np.testing.assert_allclose(
            getattr(run.model, name), np.mean([values[name] for values in seen], axis=0), rtol=0, atol=1e-5
        )
        assert np.abs(getattr(run.model, name) - getattr(plain.model, name)).max() > 1e-4
    run.close()
    plain.close()


def test_it_begins_again_when_gaussians_go():
    run = run_of()
    while run.iteration < 10 + STEPS - 3:
        run.advance()
    assert run.average.samples > 1
    run._keep(np.arange(run.model.count) != 4)
    assert run.average.samples == 0 and not run.average.values
    run.advance()
    assert run.average.samples == 1
    to_the_end(run)


def test_memory_and_disk_for_it_are_foreseen():
    plan = replace(prune_settings("removal", 10, STEPS), target=900)
    assert plan.averaged_count(1000) == 900 and replace(plan, target=0, share=0.5).averaged_count(1000) == 500
    assert replace(plan, target=0).averaged_count(1000) == 1000
    assert prune_settings("maskgs", 10, STEPS).averaged_count(1000) == 0
    values = 4 * (memory.ROW_FLOATS + 3 * 16)
    needed = [memory.tuning(1000, 16, [scenes.camera(8, 8)], 0, averaged) for averaged in (0, 100, 900)]
    assert needed[0] == needed[1] and needed[2] - needed[0] == 900 * values - 100 * memory.PROJECTED
    assert memory.checkpoint(1000, 16, 1000) - memory.checkpoint(1000, 16) == 1000 * values
    assert memory.checkpoint(1000, 16, 100) == memory.checkpoint(1000, 16)
