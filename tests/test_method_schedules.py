"""When each method acts, what it keeps unless told otherwise, and how gns reaches its budget."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import RANKED, prune_settings, train_settings
from short_runs import counts_of, to_the_end
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import gns
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run


def test_a_shorter_schedule_keeps_the_spacing_of_what_needs_views():
    for share, (start, until, every, resets) in {
        1: (500, 15_000, 100, 3_000),
        0.1: (500, 1_500, 100, 3_000),
        0.02: (100, 300, 100, 3_000),
    }.items():
        train, recover = train_settings("svr", 30_000, 5_000, schedule=share).phases
        rule = train.densify
        assert (train.steps, recover.steps) == (30_000 * share, 5_000 * share)
        assert (rule.start, rule.until, rule.every, rule.reset_every) == (start, until, every, resets)
        assert train.rates.mask == pytest.approx(
            train_settings("svr", 30_000, 5_000).phases[0].rates.mask / share
        )


def test_opacities_are_reset_where_gaussians_are_added():
    for share in (1.333, 2.5):
        rule = train_settings("svr", 30_000, 5_000, schedule=share).phases[0].densify
        assert rule.reset_every % rule.every == 0 and abs(rule.reset_every - 3_000 * share) <= rule.every


def prepared(method: str, steps: int) -> Run:
    """Training before its first step."""
    scene = scenes.random_scene(5)
    run = Run(Model.of(scene), photographed(scene), train_settings(method, steps, 0), None)
    run.method.prepare(run, run.plan.phases[0], 1)
    return run


def test_maskgs_counts_in_its_window():
    """Alpha: 19 000 to 20 000 of 30 000, both included, and the same share of shorter runs; masks are drawn
    all the time."""
    for steps, inside, outside in (
        (30_000, (19_000, 19_500, 20_000), (1, 18_999, 20_001)),
        (300, (190, 200), (189, 201)),
    ):
        run = prepared("maskgs-alpha", steps)
        weights = [
            run.method.terms(run, run.plan.phases[0], number)["lambda_m"] for number in (*inside, *outside)
        ]
        assert weights == [0.1] * len(inside) + [0.0] * len(outside)
        assert "masks" in run.method.terms(run, run.plan.phases[0], 1)


@pytest.mark.parametrize(
    ("method", "weight"), [("maskgs", 5e-4), ("maskgs-beta", 5e-4), ("maskgs-gamma", 1e-3)]
)
def test_the_other_maskgs_count_all_the_time(method, weight):
    run = prepared(method, 300)
    assert {run.method.terms(run, run.plan.phases[0], number)["lambda_m"] for number in (1, 150, 300)} == {
        weight
    }


def test_maskgs_after_training_decides_once():
    """0.1 inside the bracket that 0.2 multiplies; no events; rates fade twelve times."""
    settings = prune_settings("maskgs", 5_000, 0)
    (phase,) = settings.phases
    assert settings.lambda_m == pytest.approx(0.02) and phase.prune_every == 0
    assert phase.rates.at(5_000, 1.0)["sh"] == pytest.approx(2.5e-3 * 0.95**12)
    assert prune_settings("maskgs", 500, 0).phases[0].rates.at(500, 1.0)["sh"] == pytest.approx(
        2.5e-3 * 0.95**12
    )
    scene = scenes.random_scene(60)
    short = replace(prune_settings("maskgs", 30, 0), mask_init=-1.0)  # ten draws would have missed some
    run = Run(Model.of(scene), photographed(scene), replace(short, target=40), NativeEngine())
    assert counts_of(run) == [60] * 29 + [40]


def test_gns_presses_in_the_last_8_of_23_parts_of_training():
    train, press, recover = train_settings("gns", 23_000, 100).phases
    assert [(phase.name, phase.steps, phase.active) for phase in (train, press, recover)] == [
        ("train", 15_000, False),
        ("prune", 8_000, True),
        ("recover", 100, False),
    ]
    assert press.rates.at(0, 1.0)["means"] == pytest.approx(train.rates.at(15_000, 1.0)["means"])
    assert press.rates.at(1, 1.0)["opacity_logits"] == pytest.approx(0.1)


@pytest.mark.parametrize("method", RANKED)
def test_methods_that_rank_only_recover_a_trained_scene(method):
    assert [phase.name for phase in prune_settings(method, 3_000, 100).phases] == ["recover"]
    assert [phase.active for phase in train_settings(method, 3_000, 100).phases] == [True, False]


def test_lightgaussian_keeps_34_percent_unless_told_otherwise():
    assert train_settings("lightgaussian", 10, 10).share == pytest.approx(0.34)
    assert train_settings("lightgaussian", 10, 10, target=7).share == 0
    assert train_settings("lightgaussian", 10, 10, share=0.5).share == 0.5


# --- gns


def test_gns_ends_at_its_budget_and_keeps_the_opaque():
    scene = scenes.random_scene(400, 1, 0, scale=0.1)
    settings = replace(prune_settings("gns", 320, 0, seed=1), target=100)
    run = to_the_end(Run(Model.of(scene), photographed(scene), settings, NativeEngine()))
    assert run.model.count == 100 and 0 < run.method.trimmed <= 320 and run.method.factor != 1.0
    kept = np.isin(np.arange(400), run.model.origin)
    assert scene.opacity_logits[kept].mean() > scene.opacity_logits[~kept].mean()


def test_gns_draws_in_proportion_to_opacity():
    model = Model.of(scenes.random_scene(30_000, sh_degree=0))
    model.opacity_logits[:] = np.where(np.arange(30_000) < 15_000, np.log(0.8 / 0.2), np.log(0.2 / 0.8))
    kept = gns.drawn_by_opacity(model, 300, [0, 2, 5])
    assert kept.sum() == 300 and kept[:15_000].sum() == pytest.approx(240, abs=5 * math.sqrt(300 * 0.16))
    assert (gns.drawn_by_opacity(model, 300, [0, 2, 6]) != kept).any()


def test_gns_finds_the_opacity_that_the_budget_reaches():
    logits = np.log(np.arange(1, 100) / np.arange(99, 0, -1)).astype(np.float32)  # opacities 0.01 ... 0.99
    assert gns.opacity_at(np.random.default_rng(0).permutation(logits), 10) == pytest.approx(0.90, rel=1e-5)
    assert gns.opacity_at(logits, 1_000) == pytest.approx(0.01, rel=1e-5)


def test_gns_removes_what_has_faded_but_never_more_than_down_to_its_budget():
    scene = scenes.random_scene(400, 1, 0)
    run = Run(Model.of(scene), photographed(scene), replace(prune_settings("gns", 320, 0), target=100), None)
    phase, faded = run.plan.phases[0], np.arange(400) % 2 == 0
    run.model.opacity_logits[faded] = -20
    assert (run.method.after_step(run, phase, 80) == ~faded).all()
    run.model.opacity_logits[:] = -20
    assert run.method.after_step(run, phase, 80).sum() == 100


def test_gns_adapts_its_pressure_beyond_a_tolerance_at_every_other_press():
    """Of 320 steps, every eighth presses, and the goal falls to 0 at step 280."""
    scene = scenes.random_scene(400)
    run = Run(Model.of(scene), photographed(scene), replace(prune_settings("gns", 320, 0), target=100), None)
    run.method.first_goal = 0.5
    for number, share, factor in (
        (9, 0.1, 1),
        (17, 0.92, 1),
        (17, 1.08, 1),
        (17, 0.88, 0.8),
        (17, 1.12, 1.2),
    ):
        opacity = share * 0.5 * (1 - (number - 1) / 280)
        run.model.opacity_logits[:], run.method.factor = np.log(opacity / (1 - opacity)), 1.0
        run.method.prepare(run, run.plan.phases[0], number)
        assert run.method.factor == factor


def test_gns_trims_to_its_budget_from_nearby_and_then_takes_small_steps():
    scene = scenes.random_scene(104)
    run = Run(Model.of(scene), photographed(scene), replace(prune_settings("gns", 320, 0), target=100), None)
    phase = run.plan.phases[0]
    assert run.method.after_step(run, phase, 83).sum() == 100 and run.method.trimmed == 83
    assert run.method.terms(run, phase, 83 + 40) == {}
    assert run.method.terms(run, phase, 83 + 41)["rates"]["opacity_logits"] == 0.025
