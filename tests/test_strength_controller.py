"""A target is reached by steering the strength; the final ranking only finishes."""

from __future__ import annotations

import math
from dataclasses import asdict, replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
import whole_jobs
from plans import prune_settings
from short_runs import to_the_end
from svrgs_addon.files import compressed_ply
from svrgs_addon.files.registry import load_scene, round_trip
from svrgs_addon.finetune import checkpoint, quality, recovery_pruning
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import method_named
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.quality import fewest_within
from svrgs_addon.finetune.recovery_pruning import RecoveryPruning
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Phase, Rates, Settings
from svrgs_addon.finetune.strength_controller import StrengthController, controller_for
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.recipes import fine_tuned
from svrgs_addon.system.errors import SceneError

STEPS = 2_000


class Plant:
    """Stands in for a run whose q moves by itself, faster the stronger it is pressed, after a dead time and
    with a lag."""

    own = None  # the target is about all of it

    def __init__(self, ease: float, dead: int, lag: int):
        self.ease, self.dead, self.lag = ease, dead, lag
        self.q = self.speed = 0.0

    def current_mask(self):
        return np.ones(1, bool)

    def step(self, number: int, strength: float):
        wanted = self.ease * strength**0.4 / STEPS if number > self.dead else 0.0
        self.speed += (wanted - self.speed) / self.lag
        self.q += self.speed


@pytest.mark.parametrize("lag", [1, 30, 60])
@pytest.mark.parametrize("dead", [0, 300, 700])
@pytest.mark.parametrize("ease", [0.1, 0.3, 1.0, 3.0])
def test_the_goal_is_reached_whatever_the_scene_is_like(monkeypatch, ease, dead, lag):
    """q moves from 10 times too slowly to 3 times too fast at strength 1; it never turns back. Worst seen:
    0.054 beyond."""
    plant, steered = Plant(ease, dead, lag), StrengthController(start=1.0)
    monkeypatch.setattr(StrengthController, "progress", lambda self, run, settled: run.q)
    for number in range(1, STEPS + 1):
        plant.step(number, steered.strength)
        steered.after_step(plant, Phase("prune", STEPS, Rates(), active=True), number)
    assert plant.q == pytest.approx(1.0, abs=0.08)


@pytest.mark.parametrize(("method", "largest"), [("svr", 10), ("maskgs", 1e4)])
def test_the_strength_stays_within_limits(monkeypatch, method, largest):
    settings, phase = Settings((), target=5), Phase("prune", STEPS, Rates(), active=True)
    steered = controller_for(settings, True, method_named(method).largest_strength)
    steered.start = 1.0
    monkeypatch.setattr(StrengthController, "progress", lambda self, run, settled: 0.0)
    for number in range(1, STEPS + 1):
        steered.after_step(Plant(1, 0, 1), phase, number)
    assert steered.strength == pytest.approx(largest)


@pytest.mark.parametrize(
    ("changes", "steered"),
    [({}, False), ({"target": 5}, True), ({"share": 0.5}, True), ({"max_loss": 0.5}, True)],
)
def test_only_what_is_asked_for_is_steered(changes, steered):
    settings = Settings((), **changes)
    assert (controller_for(settings, True, 10.0) is not None) == steered
    assert controller_for(settings, False, 10.0) is None


def steered_run(tiny, data, method: str, steps: int = 1_200, seed: int = 3, **goal) -> Run:
    scene = load_scene(tiny.splat)
    settings = prune_settings(method, steps, 0, seed=seed, **goal)
    return Run(Model.of(fine_tuned.first_scene(scene, data, settings)), data, settings, NativeEngine())


@pytest.mark.slow
@pytest.mark.parametrize("target", [90, 140])
@pytest.mark.parametrize("method", ["svr", "maskgs", "compact3dgs"])
def test_masks_alone_come_near_the_target(tiny, data, method, target):
    """Of 240; the ranking then meets it exactly."""
    run = to_the_end(steered_run(tiny, data, method, target=target))
    assert run.model.count == target
    assert run.controller.reached == pytest.approx(target, rel=0.03, abs=3)


@pytest.mark.slow
def test_the_drop_asked_for_is_used_up_and_not_exceeded(tiny, data):
    """In most runs: one Gaussian of this tiny scene can be worth tenths of a dB, and now and then a run loses
    several or next to nothing. Of 21 seeds two lost more than asked; the median was 0.66 dB."""
    drops = []
    for seed in range(1, 6):
        run = to_the_end(steered_run(tiny, data, "svr", max_loss=1.0, seed=seed))
        assert run.model.count < 200
        drops.append(run.controller.start - run.quality(None))
    assert 0.1 < sorted(drops)[2] <= 1.0 and sum(drop <= 1.0 for drop in drops) >= 4, drops


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "allowed"), [("removal", 0.2), ("removal", 0.4), ("svr", 0.5), ("svr", 1.0), ("gns", 1.0)]
)
def test_what_the_recovery_wins_back_is_spent(tiny, data, tmp_path, method, allowed):
    """In most runs: one Gaussian of this tiny scene can be worth tenths of a dB. With `removal` a twentieth,
    the least that stays, loses about 0.3 dB."""
    data = replace(data, train_indices=[1, 3, 5, 7, 9, 11], test_indices=[0, 2, 4, 6, 8, 10])
    drops, cuts = [], []
    for seed in range(3):
        settings = replace(prune_settings(method, 300, 200), max_loss=allowed, seed=seed)
        result = whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / f"{seed}.ply"))
        left = result["curves"]["count"]
        (
            drops.append(result["drop"]),
            cuts.append(left[-1] < left[list(result["curves"]["iteration"]).index(300)]),
        )
    assert allowed - 0.7 < sorted(drops)[1] < allowed + 0.4 and sum(cuts) >= 2, (drops, cuts)


def test_more_is_cut_where_more_is_won_back():
    """Never to be more than RECOVERED of the cut's cost."""
    first = RecoveryPruning(start=30.0)
    assert first.recovered_share(31.0) == recovery_pruning.RECOVERED
    for now, share in ((29.5, recovery_pruning.DECAY * 0.5), (28.5, 0.0), (31.0, recovery_pruning.RECOVERED)):
        assert RecoveryPruning(start=30.0, before_cut=30.0, after_cut=29.0).recovered_share(
            now
        ) == pytest.approx(share)


@pytest.mark.parametrize(
    "stop",
    [
        pytest.param(501, marks=pytest.mark.slow),
        pytest.param(650, marks=pytest.mark.slow),
        651,
        pytest.param(790, marks=pytest.mark.slow),
    ],
)
def test_a_recovery_that_cuts_goes_on_from_a_checkpoint_bit_for_bit(tiny, data, tmp_path, stop):
    settings = replace(prune_settings("removal", 500, 300), max_loss=0.2)
    whole, first, second = (
        Run(Model.of(load_scene(tiny.splat)), data, settings, NativeEngine()) for _ in range(3)
    )
    while first.iteration < stop:
        first.advance()
    first.close()
    checkpoint.save(first, tmp_path, "same")
    assert checkpoint.restore(second, tmp_path, "same") and second.recovery_pruning == first.recovery_pruning
    while whole.iteration < 500:
        whole.advance()
    removed = whole.model.count
    to_the_end(second), to_the_end(whole)
    assert second.recovery_pruning == whole.recovery_pruning and whole.recovery_pruning.after_cut > 0
    assert whole.model.count < removed, "the recovery cuts"
    assert all(
        value.tobytes() == whole.model.values[name].tobytes() for name, value in second.model.values.items()
    )


@pytest.mark.parametrize(
    "goal",
    [{"target": 90}, pytest.param({"max_loss": 1.0}, marks=pytest.mark.slow)],
    ids=["target", "max-drop"],
)
def test_a_steered_run_restored_from_a_checkpoint_goes_on_bit_for_bit(tiny, data, tmp_path, goal):
    whole, first, second = (steered_run(tiny, data, "svr", 600, **goal) for _ in range(3))
    while first.iteration < 501:
        first.advance()
    first.close()
    checkpoint.save(first, tmp_path, "same")
    assert checkpoint.restore(second, tmp_path, "same")
    assert asdict(second.controller) == asdict(first.controller) != asdict(StrengthController())
    to_the_end(second), to_the_end(whole)
    assert asdict(second.controller) == asdict(whole.controller)
    assert all(
        value.tobytes() == whole.model.values[name].tobytes() for name, value in second.model.values.items()
    )


@pytest.mark.parametrize("method", ["opacity", "lightgaussian", "3dgs"])
def test_a_drop_cannot_be_asked_of_methods_without_masks(data, method):
    settings = replace(prune_settings(method, 100, 0), max_loss=0.5)
    with pytest.raises(SceneError, match="cannot take --max-drop"):
        fine_tuned.check_request(data, settings)


def test_the_command_line_reaches_the_drop(tiny, svrgs, tmp_path):
    words = f"--max-drop 2 --iterations 600 --recovery 0 --quiet --json --out {tmp_path}/o.ply"
    result = svrgs("prune", tiny.splat, "--data", tiny.folder, words).json
    assert result["count"] < tiny_dataset.COUNT and result["target"] is None and result["strength"] > 0
    refused = svrgs("prune", tiny.splat, "--data", tiny.folder, "--target", 0.5, words)
    assert refused.status == 2 and "not allowed with" in refused.err


def test_an_allowed_drop_keeps_a_twentieth_at_least_and_needs_photographs_that_show_something(tiny, data):
    plan = replace(prune_settings("removal", 60, 0), max_loss=1.0)
    run = Run(Model.of(load_scene(tiny.splat)), data, plan, NativeEngine())
    assert fewest_within(run, np.arange(run.model.count), -10.0).sum() == math.ceil(
        quality.MIN_SHARE * run.model.count
    )
    run.recovery_pruning.before_step(run)
    black = replace(run.plan, max_loss=60.0)
    with pytest.raises(SceneError, match="even an empty scene loses less than the 60 dB allowed"):
        RecoveryPruning().before_step(Run(Model.of(load_scene(tiny.splat)), data, black, NativeEngine()))


def test_a_drop_is_measured_on_test_views_and_on_training_views_if_there_are_none(data):
    assert quality.quality_views(data) == data.test_indices and data.test_indices
    assert quality.quality_views(replace(data, test_indices=[])) == data.train_indices
    many = quality.quality_views(replace(data, test_indices=list(range(100))))
    assert len(many) == len(set(many)) == quality.VIEWS and many[0] == 0 and many[-1] >= 93


def test_a_drop_counts_from_the_scene_before_its_first_cut(tiny, data, tmp_path):
    settings = replace(prune_settings("svr", 60, 0), max_loss=6.0, min_contribution=0.2)
    result = whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / "o.ply"))
    assert result["first_cut"] > 20
    assert result["drop"] == pytest.approx(result["before"]["psnr"] - result["psnr"], abs=1e-3)


def test_a_drop_counts_what_the_format_of_the_output_loses(tiny, data, tmp_path):
    settings = replace(prune_settings("svr", 60, 0), max_loss=2.0)
    result = whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / "o.compressed.ply"))
    assert result["drop"] == pytest.approx(result["before"]["psnr"] - result["psnr"], abs=1e-3)
    source = load_scene(tiny.splat)
    left = fine_tuned.without_format_loss(source, data, settings, tmp_path / "o.compressed.ply").max_loss
    recipe = fine_tuned.FineTuned(tiny.splat, settings, JobContext(tmp_path / "o.ply"), lambda _: data)
    recipe.open()
    recipe.views()
    held, seen = (
        recipe.measured(scene, tiny.splat)["psnr"]
        for scene in (source, round_trip(source, compressed_ply.FORMAT)[0])
    )
    assert 2.0 - left == pytest.approx(max(0.0, held - seen), abs=1e-3) and left < 2.0
    assert fine_tuned.without_format_loss(source, data, settings, tmp_path / "o.ply").max_loss == 2.0
    with pytest.raises(SceneError, match="o.splat: the format alone loses"):
        whole_jobs.prune(
            tiny.splat,
            replace(data, test_indices=[6, 8]),
            replace(settings, max_loss=0.01),
            JobContext(tmp_path / "o.splat"),
        )
    assert not (tmp_path / "o.splat").exists()
