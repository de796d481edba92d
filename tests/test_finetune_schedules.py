"""When a run does what: rates, phases, the SH degree, densification, and opacity resets."""

from dataclasses import replace

import pytest

import scenes
from pictures import photographed
from plans import plan_of, prune_settings, train_settings
from short_runs import Puller, logit
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.plan import Plan
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify, Phase, Rates, recovery_phase
from svrgs_addon.system.errors import SceneError


def small_run(settings: Plan) -> Run:
    scene = scenes.random_scene(5)
    return Run(Model.of(scene), photographed(scene), settings, None)


# --- rates


@pytest.mark.parametrize(
    ("step", "rate"), [(1, 1.5997544e-4), (15_000, 1.6e-5), (30_000, 1.6e-6), (40_000, 1.6e-6)]
)
def test_the_position_rate_falls_log_linearly_and_scales_with_the_scene(step, rate):
    assert Rates().at(step, 1.0)["means"] == pytest.approx(rate, rel=1e-6)
    assert Rates().at(step, 4.5)["means"] == pytest.approx(4.5 * rate, rel=1e-6)


def test_the_other_rates_are_those_of_3dgs():
    expected = dict(
        log_scales=5e-3, quats=1e-3, opacity_logits=0.05, sh=2.5e-3, sh_rest=1.25e-4, mask_logits=0.02
    )
    for step in (1, 400, 29_999):
        rates = Rates().at(step, 3.0)
        assert {name: rates[name] for name in expected} == expected


@pytest.mark.parametrize(
    ("step", "share"), [(1, 1.0), (399, 1.0), (400, 0.95), (799, 0.95), (800, 0.95**2), (4_999, 0.95**12)]
)
def test_recovery_fades_every_400_steps_but_for_the_positions(step, share):
    rates, plain = recovery_phase(5_000).rates.at(step, 2.0), Rates().at(step, 2.0)
    for name in plain.keys() - {"means"}:
        assert rates[name] == pytest.approx(share * plain[name], rel=1e-12)
    assert rates["means"] == pytest.approx(2 * 5e-6 * (1.6e-6 / 5e-6) ** (step / 5_000), rel=1e-9)


def test_recovery_after_training_begins_where_the_position_rate_ended():
    train, recover = train_settings("svr", 7_000, 1_000).phases
    assert recover.rates.at(0, 1.0)["means"] == pytest.approx(train.rates.at(7_000, 1.0)["means"], rel=1e-12)


@pytest.mark.parametrize(("steps", "larger"), [(30_000, 1), (12_800, 1), (3_200, 2), (800, 4), (100, 4)])
def test_a_short_training_takes_larger_steps_and_ends_with_small_ones(steps, larger):
    rates, usual = train_settings("3dgs", steps, 0).phases[0].rates, Rates()
    for name in ("scale", "rotation", "sh", "sh_rest"):
        assert getattr(rates, name) == pytest.approx(larger * getattr(usual, name), rel=1e-3)
    assert (rates.opacity, rates.mask) == (usual.opacity, usual.mask)
    assert rates.at(0, 1.0)["means"] == pytest.approx(min(larger, 2) * 1.6e-4)
    assert rates.at(steps, 1.0)["means"] == pytest.approx(1.6e-6)


def test_a_long_training_has_the_rates_of_3dgs():
    assert (
        train_settings("3dgs", 30_000, 0).phases[0].rates
        == train_settings("3dgs", 40_000, 0).phases[0].rates
        == Rates()
    )


def test_phases_follow_one_another_and_number_their_own_steps():
    settings = prune_settings("svr", 3, 2)
    found = []
    for iteration in range(settings.total):
        phase, number = settings.at(iteration)
        found.append((phase.name, number, phase.active))
    assert found == [
        ("prune", 1, True),
        ("prune", 2, True),
        ("prune", 3, True),
        ("recover", 1, False),
        ("recover", 2, False),
    ]


def test_the_sh_degree_rises_every_thousand_steps_of_training():
    run = small_run(train_settings("svr", 30_000, 0))
    (phase,) = run.plan.phases
    degrees = [
        run.render_options(phase, number).sh_degree for number in (1, 999, 1_000, 2_500, 3_000, 29_999)
    ]
    assert degrees == [0, 0, 1, 2, 3, 3]


def test_a_short_training_learns_every_sh_degree_and_densifies():
    run = small_run(train_settings("3dgs", 700, 0, densify=Densify.within(700)))
    (phase,) = run.plan.phases
    assert [run.render_options(phase, number).sh_degree for number in (99, 100, 299, 300)] == [0, 1, 2, 3]
    assert [number for number in range(1, 701) if run._densifies(phase, number)] == [200, 300]


def test_the_spatial_mask_is_drawn_only_while_masks_are_learned():
    settings = prune_settings("svr-a", 10, 10)
    run = small_run(settings)
    assert [run.render_options(phase, 1).mask_kind for phase in settings.phases] == ["a", "none"]


# --- schedules of growth


def scheduled(rule: Densify, steps: int, **changes) -> tuple[Run, list[tuple[int, int]]]:
    """A run of the Puller, and (iteration, count) wherever the count changed."""
    scene = scenes.random_scene(6, sh_degree=0, scale=1e-3, anisotropy=0.0, opacity=3.0)
    phase = Phase("train", steps, Rates(), rule, **changes)
    run = Run(Model.of(scene), photographed(scene), plan_of("3dgs", (phase,)), Puller())
    changes = []
    while not run.finished:
        before = run.model.count
        run.advance()
        if run.model.count != before:
            changes.append((run.iteration, run.model.count))
    run.close()
    return run, changes


def test_densification_keeps_its_times():
    """After `start`, before `until`, every `every`; there the optimiser rests, and only there."""
    run, changes = scheduled(Densify(start=10, until=30, every=5, reset_every=1_000), 40)
    assert changes == [(15, 7), (20, 8), (25, 9)]
    assert [i + 1 for i, step in enumerate(run.engine.steps) if not step.update] == [15, 20, 25]
    assert [step.want_means2d for step in run.engine.steps] == [i < 30 for i in range(1, 41)]


def test_opacity_resets_keep_their_times():
    """At multiples of reset_every before `until`, with steps left to return; what is huge goes only at
    densifications after the first."""
    rule = Densify(start=1, until=30, every=4, reset_every=10, max_scale=1e-6)
    run, _ = scheduled(replace(rule, until=10), 12)
    assert run.model.opacity_logits.max() > logit(0.01) + 0.1
    run, _ = scheduled(replace(rule, max_scale=1.0), 13)
    assert run.model.opacity_logits.max() == pytest.approx(logit(0.01), rel=1e-6)
    run, _ = scheduled(replace(rule, max_scale=1.0), 12)
    assert run.model.opacity_logits.max() > logit(0.01) + 0.1
    with pytest.raises(SceneError, match="would leave 0"):
        scheduled(rule, 12)  # everything is "huge" at iteration 12, not yet at 4 and 8
    scheduled(rule, 11)


def test_a_new_loss_counts_a_twentieth_in_the_smoothed_one():
    class Losing(Puller):
        def step(self, model, step):
            return replace(super().step(model, step), l1=float(1 + len(self.steps)), ssim=1.0)

    scene, phase = scenes.random_scene(4), Phase("train", 9, Rates())
    run = Run(Model.of(scene), photographed(scene), plan_of("3dgs", (phase,)), Losing())
    for expected in (0.8 * 2, 0.8 * (2 + 0.05)):
        run.advance()
        assert run.loss == pytest.approx(expected)
    run.close()
