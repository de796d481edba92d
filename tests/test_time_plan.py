"""`--time`: the schedule that fits, what is refused, what the result says, and that a resumed job keeps its
plan."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from command_checks import refused
from job_checks import create
from plans import prune_settings, train_settings
from short_runs import to_the_end
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, removal
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.plan import at_schedule
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.saliency import views_that_see
from svrgs_addon.finetune.settings import MCMC
from svrgs_addon.finetune.strength_controller import UPDATES
from svrgs_addon.jobs.estimate import estimate
from svrgs_addon.prune import duration, planning, time_plan
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.duration import Pace, pace_of
from svrgs_addon.prune.options import PruneOptions, TrainOptions
from svrgs_addon.prune.pipeline import prune_scene, train_scene
from svrgs_addon.prune.recipes import fine_tuned
from svrgs_addon.prune.time_plan import GRID, MAX_SCHEDULE, MIN_SCHEDULE, fitted
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system.errors import Cancelled, FormatError, SceneError

SLOW = Pace(
    count=250, step=0.1, power=0.4, ranking=0.5, drawn=0.02, point=0.04, measured=0.1, photograph=0.01,
    train_views=10, test_views=2, uncached=0.0,
)  # fmt: skip
PRUNING = [name for name, method in METHODS.items() if method.prunes]
SCHEDULES = (0.01, 0.02, 0.05, 0.1, 0.3, 1.0)


def whole(method: str, **more):
    """The plan of `svrgs prune` with all steps."""
    return prune_settings(method, 3_000, 5_000, target=60, **more)


@pytest.fixture
def slow(monkeypatch):
    """A machine of a known speed."""
    monkeypatch.setattr(planning, "pace_of", lambda *_: SLOW)
    within = fine_tuned.pruning_within
    monkeypatch.setattr(
        fine_tuned,
        "pruning_within",
        lambda plan, source, _read, *more: within(plan, source, 0.1, *more),
    )
    monkeypatch.setattr(JobContext, "seconds", lambda self: 1.5)


@pytest.mark.parametrize("method", PRUNING)
def test_more_steps_and_more_gaussians_take_longer(method):
    plan = whole(method)
    by_schedule = [SLOW.pruning(at_schedule(plan, schedule), 0.2) for schedule in SCHEDULES]
    assert by_schedule == sorted(by_schedule) and by_schedule[-1] > 5 * by_schedule[0]
    by_share = [SLOW.pruning(plan, share) for share in (0.02, 0.1, 0.5, 1.0)]
    assert by_share == sorted(by_share) and by_share[0] < by_share[-1]


TRAINED = (
    ("3dgs", {}),
    ("removal", {"target": 60}),
    ("svr", {}),
    ("opacity", {"share": 0.5}),
    ("speedy", {}),
    ("3dgs", {"densify": MCMC.capped(2_000, 30_000)}),
)


@pytest.mark.parametrize("method, more", TRAINED)
def test_a_longer_training_takes_longer(method, more):
    plan = train_settings(method, 30_000, 5_000, **more)
    seconds = [SLOW.training(at_schedule(plan, schedule)) for schedule in SCHEDULES]
    assert seconds == sorted(seconds) and seconds[-1] > 90 * seconds[0], "later steps have more Gaussians"
    first, *others = plan.phases
    assert SLOW.training(replace(plan, phases=(replace(first, coarse_until=9_000), *others))) < seconds[-1]
    shorter = train_settings(method, 30_000, 5_000, schedule=0.0375, **more)
    assert repr(at_schedule(plan, 0.0375)) == repr(shorter)


LOOKING = "removal saliency speedy popspa minisplatting efficientgs opacity lightgaussian".split()


@pytest.mark.parametrize("method", [*LOOKING, "reduced3dgs", "maskgs", "gns"])
def test_a_method_foresees_its_looks(method, data, tiny, monkeypatch):
    """As many as score() is called in a run, each over all training views, and views_that_see()."""
    plan, calls = prune_settings(method, 120, 10, target=60), []
    cls, scene = type(plan.method), read_ply(tiny.splat)
    score = lambda self, viewed, score=cls.score: calls.append(len(viewed.cameras)) or score(self, viewed)
    monkeypatch.setattr(cls, "score", score)
    seen = lambda viewed: calls.append(len(viewed.cameras)) or views_that_see(viewed)
    monkeypatch.setattr(removal, "views_that_see", seen)
    run = Run(Model.of(scene), data, plan, NativeEngine())
    if plan.method.ranks:
        plan.method.cut(replace(run.viewed, scene=scene), 60)
    to_the_end(run)
    foreseen = plan.method.ranking_passes(plan, 0 if plan.method.ranks else 120, 60 / scene.count)
    assert calls == [len(data.train_indices)] * len(foreseen) and bool(foreseen) == (method in LOOKING)
    assert foreseen == sorted(foreseen, key=lambda look: look[0])
    assert all(left == pytest.approx(60 / scene.count) for _, left in foreseen[-1:])


def test_a_longer_time_gives_as_many_steps_or_more_and_never_too_many():
    plan = whole("removal")
    seconds = lambda some: SLOW.pruning(some, 0.2)
    found = [fitted(asked, plan, seconds, 3.0) for asked in (20, 25, 30, 60, 100, 300, 2_000, 10_000)]
    schedules = [one.schedule for one in found]
    assert schedules == sorted(schedules) and schedules[0] < 0.05 and schedules[-1] == MAX_SCHEDULE
    for one in found:
        assert one.foreseen == 3.0 + seconds(at_schedule(plan, one.schedule)) <= one.asked
        assert one.schedule == MAX_SCHEDULE or 3.0 + seconds(
            at_schedule(plan, round(one.schedule * GRID + 1) / GRID)
        ) > one.asked * (1 - time_plan.MARGIN)


def test_a_time_that_is_too_short_is_refused_with_one_that_is_enough():
    plan = whole("removal")
    with pytest.raises(SceneError, match=r"^2 s are too short: .* allow (\d+) s or more$") as caught:
        fitted(2, plan, lambda some: SLOW.pruning(some, 0.2), 3.0)
    enough = int(str(caught.value).split("allow ")[1].split()[0])
    assert fitted(enough, plan, lambda some: SLOW.pruning(some, 0.2), 3.0).schedule >= MIN_SCHEDULE
    with pytest.raises(SceneError):
        fitted(enough - 1, plan, lambda some: SLOW.pruning(some, 0.2), 3.0)


@pytest.mark.parametrize("method", PRUNING)
def test_the_plan_is_that_of_the_schedule_alone(method):
    assert repr(at_schedule(whole(method), 0.0375)) == repr(whole(method, schedule=0.0375))


def test_the_result_says_what_was_asked_foreseen_and_used_and_can_be_repeated(tiny, svrgs, slow, tmp_path):
    words = ["prune", tiny.splat, "--data", tiny.folder, "--target", 0.4, "--json"]
    done = svrgs(*words, "--time", 20, "--out", tmp_path / "a.ply")
    time = done.json["time"]
    assert time["asked"] == 20 and 15 < time["foreseen"] <= 18.4 and time["used"] == 1.5
    assert MIN_SCHEDULE < time["schedule"] < 0.1
    (line,) = [line for line in done.err.splitlines() if line.startswith("--time 20: ")]
    assert f"{done.json['iterations']:,} steps" in line and f"about {time['foreseen']:.0f} s" in line
    assert f"--schedule {time['schedule']}" in line
    assert not any("were allowed" in note for note in done.json["notes"])
    again = svrgs(*words, "--schedule", time["schedule"], "--out", tmp_path / "b.ply")
    assert again.json["time"] is None and "--time" not in again.err
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()


@pytest.mark.slow
def test_the_quality_is_said_where_it_is_foreseen(tiny, svrgs, slow, tmp_path):
    done = svrgs(
        f"prune {tiny.splat} --data {tiny.folder} --target 0.4 --json --time 110", f"--out {tmp_path}/a.ply"
    )
    assert done.json["iterations"] >= 800 and " dB or more (now " in done.err
    quiet = svrgs(
        f"prune {tiny.splat} --data {tiny.folder} --target 0.4 --json --time 20 --quiet",
        f"--out {tmp_path}/a.ply",
    )
    assert quiet.json["time"]["schedule"] and not quiet.err


def test_a_budget_from_lambda_is_measured_on_the_way(tiny, svrgs, slow, tmp_path):
    done = svrgs(
        "prune", tiny.splat, "--data", tiny.folder, "--json", "--time", 20, "--out", tmp_path / "a.ply"
    )
    assert done.json["count"] < 250 and f" of {done.json['before']['count']} Gaussians stay" in done.err


def test_a_time_that_is_too_short_writes_nothing(tiny, svrgs, slow, tmp_path):
    done = svrgs("prune", tiny.splat, "--data", tiny.folder, "--time", 2, "--out", tmp_path / "a.ply")
    refused(done, "2 s are too short", "allow ")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    ["--schedule 0.1", "--schedule 1", "--iterations 3000", "--recovery 10", "--recovery 10 --schedule 2"],
)
@pytest.mark.parametrize("command", ["prune", "train"])
def test_a_time_and_a_number_of_steps_exclude_each_other(tiny, svrgs, tmp_path, command, words):
    scene = [tiny.splat] if command == "prune" else []
    done = svrgs(command, *scene, "--data", tiny.folder, "--out", tmp_path / "a.ply", "--time", 60, words)
    refused(done, "--time chooses the number of steps", *words.split()[::2])


@pytest.mark.parametrize("word", ["0", "-3", "nan", "inf", "soon"])
def test_a_time_is_a_number_of_seconds(tiny, svrgs, tmp_path, word):
    done = svrgs("prune", tiny.splat, "--data", tiny.folder, "--out", tmp_path / "a.ply", "--time", word)
    refused(done, "is not a number of seconds above 0")


def test_a_program_that_gives_both_is_told_so(tiny, tmp_path):
    given = PruneOptions(scene=tiny.splat, data=tiny.folder, out=tmp_path / "a.ply", time=60, iterations=5)
    with pytest.raises(SceneError, match="leave out --iterations"):
        prune_scene(given)
    with pytest.raises(SceneError, match="leave out --recovery"):
        create(tmp_path / "job", tiny, time=60, recovery=5)


# --- resuming


def stopped(after: int):
    """An adapt() that stops a job after so many steps; 0: never."""
    seen = [0]
    stop = lambda: bool(after) and seen[-1] >= after
    return lambda context: replace(context, observe=lambda p: seen.append(p.iteration), stop=stop)


def job(tiny, out, stop_after: int = 0, **more) -> dict:
    """`svrgs prune --time 20 --resume`, stopped after so many steps."""
    given = {"scene": tiny.splat, "data": tiny.folder, "target": 0.4, "time": 20.0} | more
    return prune_scene(PruneOptions(out=out, quiet=True, resume=True, **given), stopped(stop_after))


@pytest.mark.slow
def test_a_resumed_job_goes_on_with_its_plan_on_a_faster_machine(tiny, slow, tmp_path, monkeypatch):
    planned = job(tiny, tmp_path / "whole.ply")["time"]
    with pytest.raises(Cancelled):
        job(tiny, tmp_path / "a.ply", stop_after=30)
    monkeypatch.setattr(planning, "pace_of", lambda *_: replace(SLOW, step=SLOW.step / 3))
    resumed = job(tiny, tmp_path / "a.ply")
    assert resumed["time"]["schedule"] == planned["schedule"] and resumed["time"]["asked"] == 20
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    # a new job is planned for this machine
    assert job(tiny, tmp_path / "b.ply")["time"]["schedule"] > planned["schedule"]


def test_a_checkpoint_for_another_time_is_not_continued(tiny, slow, tmp_path):
    with pytest.raises(Cancelled):
        job(tiny, tmp_path / "a.ply", stop_after=30)
    with pytest.raises(FormatError, match="its checkpoint is of a run with --time 20"):
        job(tiny, tmp_path / "a.ply", time=40.0)
    assert job(tiny, tmp_path / "a.ply")["time"]["asked"] == 20


def test_a_job_with_a_time_can_be_continued_with_its_schedule(tiny, slow, tmp_path):
    planned = job(tiny, tmp_path / "whole.ply")["time"]
    with pytest.raises(Cancelled):
        job(tiny, tmp_path / "a.ply", stop_after=30)
    assert job(tiny, tmp_path / "a.ply", time=0.0, schedule=planned["schedule"])["time"] is None
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.slow
def test_training_keeps_its_plan_too(tiny, slow, tmp_path, monkeypatch):
    def training(name: str, stop_after: int = 0, **more) -> dict:
        given = {"data": tiny.folder, "sh_degree": 1, "time": 60.0} | more
        options = TrainOptions(out=tmp_path / name, quiet=True, resume=True, **given)
        return train_scene(options, stopped(stop_after))

    planned = training("whole.ply")["time"]
    assert planned["asked"] == 60 and planned["foreseen"] <= 48 and MIN_SCHEDULE < planned["schedule"] < 0.05
    with pytest.raises(Cancelled):
        training("a.ply", stop_after=30)
    monkeypatch.setattr(planning, "pace_of", lambda *_: replace(SLOW, step=1e-3))
    assert training("a.ply")["time"]["schedule"] == planned["schedule"]
    training("b.ply", time=0.0, schedule=planned["schedule"])
    assert len({(tmp_path / f"{name}.ply").read_bytes() for name in ("whole", "a", "b")}) == 1


# --- what is measured


def test_speeds_are_measured_and_the_scene_stays_as_it_was(tiny, data):
    scene = read_ply(tiny.splat)
    before = {name: getattr(scene, name).tobytes() for name in PARAMETERS}
    pace = pace_of(scene, data, whole("removal"))
    assert min(pace.step, pace.ranking, pace.drawn, pace.point, pace.measured, pace.photograph) > 0
    assert (pace.train_views, pace.test_views) == (len(data.train_indices), len(data.test_indices))
    assert pace.uncached == 0
    assert before == {name: getattr(scene, name).tobytes() for name in before}
    assert pace_of(scene, replace(data, memory_budget=0), whole("opacity")).uncached == 1
    assert pace_of(scene, data, whole("maskgs")).ranking == 0, "it ranks nothing between the steps"


def test_writing_is_foreseen_where_it_takes_time(tiny, data, monkeypatch, tmp_path):
    scene, given = read_ply(tiny.splat), []

    def slow_trip(part, splat_format, seen):
        given.append((part.count, splat_format.name, seen is not None))
        time.sleep(0.05)

    monkeypatch.setattr(planning, "round_trip", slow_trip)
    monkeypatch.setattr(planning, "PART", 50)
    assert planning._rounding(scene, data, 200, tmp_path / "a.ply") == 0 and not given
    assert planning._rounding(scene, data, 200, tmp_path / "a.spz") >= 4 * 0.05
    assert given == [(50, "spz", True)]


@pytest.mark.parametrize(("measured", "power"), [(0.7, 0.4), (0.0, 0.1), (1.0, 0.6)])
def test_steps_gain_less_from_fewer_gaussians_where_pixels_take_most_of_their_time(
    tiny, data, monkeypatch, measured, power
):
    """measured: the power with some of the Gaussians. Of those that stay in a run it is 0.3 less, within
    limits. A training does not measure it."""
    scene, counts = read_ply(tiny.splat), []
    monkeypatch.setattr(
        duration,
        "_step",
        lambda some, dataset, plan: counts.append(some.count) or 0.1 / duration.SOME**measured,
    )
    assert duration._power(0.1, scene, data, whole("removal")) == pytest.approx(power)
    assert counts == [-(-scene.count // duration.SOME)]
    assert duration._power(0.1, scene, data, train_settings("3dgs", 300, 0)) == duration.TRAINING_POWER


@pytest.mark.parametrize(("share", "every"), [(0.5, 2), (0.25, 4), (0.01, 16), (0.9, 2), (None, 16)])
def test_steps_on_merged_gaussians_are_measured_with_as_many_as_stay(tiny, data, monkeypatch, share, every):
    """Without a known number (an allowed drop), as for other methods."""
    scene, counts = read_ply(tiny.splat), []
    monkeypatch.setattr(
        duration, "_step", lambda some, dataset, plan: counts.append(some.count) or 0.1 / every**0.8
    )
    plan = replace(whole("merge"), target=round(share * scene.count) if share else 0)
    assert duration._power(0.1, scene, data, plan) == pytest.approx(0.75)
    assert counts == [-(-scene.count // every)]


def test_an_estimate_chooses_the_schedule_of_a_time(tiny, monkeypatch):
    from svrgs_addon.jobs import estimate as module

    monkeypatch.setattr(module, "pace_of", lambda *_: SLOW)
    options = PruneOptions(scene=tiny.splat, data=tiny.folder, target=0.4)
    every = estimate(options)
    assert every["schedule"] == 1 and every["steps"] == 8_000 and every["seconds"] > 400
    some = estimate(replace(options, time=30.0))
    assert some["schedule"] < 0.1 and some["steps"] < 800 and 25 < some["seconds"] <= 30
    assert json.dumps(some)
    with pytest.raises(SceneError, match="3 s are too short"):
        estimate(replace(options, time=3.0))


def test_a_job_that_took_longer_than_it_may_says_so():
    planned = time_plan.TimePlan(12.0, 10.8, 0.1)
    assert planned.late(12.4) == []
    (note,) = planned.late(16.9)
    assert "took 17 s, more than the 12 s that were allowed" in note


def test_the_result_of_a_late_job_has_the_note(tiny, svrgs, slow, tmp_path, monkeypatch):
    monkeypatch.setattr(time_plan, "LATE", 0.05)
    words = ["prune", tiny.splat, "--data", tiny.folder, "--target", 0.4, "--json", "--time", 20]
    result = svrgs(*words, "--out", tmp_path / "a.ply").json
    assert any("took 2 s, more than the 20 s that were allowed" in note for note in result["notes"])


def test_growth_up_to_a_cap_makes_steps_no_slower_than_the_cap_does():
    phase = train_settings("3dgs", 30_000, 0, densify=MCMC.capped(500, 30_000)).phases[0]
    assert duration.growth(phase, 250)[1] == pytest.approx(2**duration.GROWTH_POWER)
    assert duration.growth(phase, 500) == (1, 1)


def test_gaussians_that_go_gradually_go_evenly():
    parts = duration.gradual(0.2)
    assert sum(length for length, _ in parts) == pytest.approx(1)
    assert sum(length * left for length, left in parts) == pytest.approx(0.6)


def test_photographs_that_do_not_stay_in_memory_are_read_again():
    plan, disk = whole("removal"), replace(SLOW, photograph=2.0)
    seconds = [replace(disk, uncached=share).pruning(plan, 0.2) for share in (0, 0.5, 1)]
    assert seconds[1] - seconds[0] == pytest.approx(seconds[2] - seconds[1]) and seconds[1] > seconds[0] + 100


def test_learned_masks_measure_an_allowed_drop_at_each_update_of_their_strength():
    judging = replace(SLOW, judged=1.0)
    drop = lambda method, **more: judging._drop(whole(method, max_loss=1.0, **more), 0.2)
    assert drop("removal", nested=0.5) == duration.BISECTION  # nothing is cut in a nested recovery
    assert drop("svr") == pytest.approx(drop("removal") + UPDATES)


def test_a_cut_that_merges_takes_as_long_as_some_steps():
    cut = lambda pace: pace._cut(whole("merge"), 0.2)
    assert cut(SLOW) - cut(replace(SLOW, step=0.0)) == pytest.approx(duration.MERGING_STEPS * SLOW.step)
