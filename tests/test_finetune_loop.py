"""Short whole runs: the same bits for any threads and after stops, both engines alike, a falling loss,
observers."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import EYES, HEIGHT, WIDTH, photographed
from plans import plan_of
from short_runs import bits, disturbed, quality, to_the_end
from svrgs_addon.finetune import loop
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.loop import run_to_end
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify, Phase, Rates, recovery_phase
from svrgs_addon.finetune.torch_engine import TorchEngine
from svrgs_addon.native import library
from svrgs_addon.system.errors import Cancelled, SceneError


def training(engine=None, dtype=np.float32) -> Run:
    """A short run that draws masks, clones, splits, resets, prunes and recovers."""
    truth = scenes.random_scene(150, 2, 1, scale=0.2)
    dataset = photographed(truth)
    rule = Densify(start=5, until=31, every=10, reset_every=25, gradient=2e-5, small=0.1)
    phases = (Phase("train", 45, Rates(), rule, active=True, prune_every=10, sh_every=15), recovery_phase(15))
    settings = plan_of("svr", phases, lambda_f=1e-3, mask_init=1.0, seed=4)
    return Run(Model.of(disturbed(truth), dtype), dataset, settings, engine or NativeEngine())


@pytest.fixture
def thread_count():
    """Sets the size of the pool; the number before comes back afterwards."""
    before = library.threads()
    yield library.set_threads
    library.set_threads(before)


def test_a_run_is_the_same_for_any_number_of_threads_and_every_time(thread_count):
    ends = []
    for threads in (1, 2, 2):
        thread_count(threads)
        run = to_the_end(training())
        assert run.iteration == 60 and run.nonfinite == 0
        # grown and pruned
        assert (run.model.origin == -1).any() and len(np.setdiff1d(np.arange(150), run.model.origin))
        ends.append((bits(run.model), run.loss))
    assert ends[0] == ends[1] == ends[2]


def test_a_run_that_was_stopped_goes_on_as_if_nothing_had_happened():
    """Closing ends the read-ahead; the next advance resumes the same order of views."""
    whole, halved = training(), training()
    to_the_end(whole)
    for stop in (7, 33, 46):
        while halved.iteration < stop:
            halved.advance()
        halved.close()
    assert bits(to_the_end(halved).model) == bits(whole.model)


def test_a_run_ends_alike_with_either_engine():
    """In float64, through growth, reset, pruning and recovery. Worst seen: 9e-15 of the largest value."""
    native_, torch_ = (
        to_the_end(training(engine("float64"), np.float64)) for engine in (NativeEngine, TorchEngine)
    )
    np.testing.assert_array_equal(native_.model.origin, torch_.model.origin)
    for name, value in native_.model.values.items():
        assert np.abs(value - torch_.model.values[name]).max() < 1e-12 * np.abs(value).max(), name


def test_the_loss_falls():
    truth = scenes.random_scene(150, 2, 1, scale=0.2)
    start, dataset = disturbed(truth), photographed(truth)
    run = to_the_end(
        Run(Model.of(start), dataset, plan_of("3dgs", (Phase("fit", 60, Rates()),)), NativeEngine())
    )
    assert run.model.count == 150
    assert quality(run.model, dataset) > quality(start, dataset) + 3


def test_a_loss_that_is_not_finite_ends_the_run_with_the_view_named():
    truth = scenes.random_scene(20, sh_degree=0)
    dataset = photographed(truth)
    dataset.pictures = [np.full((HEIGHT, WIDTH, 3), np.nan, np.float32)] * len(EYES)
    dataset.cameras = [replace(camera, name="bad.png") for camera in dataset.cameras]
    run = Run(Model.of(truth), dataset, plan_of("3dgs", (Phase("fit", 5, Rates()),)), NativeEngine())
    with pytest.raises(SceneError, match=r"iteration 1 .*bad\.png"):
        run.advance()
    run.close()


def test_observers_see_each_step_and_curves_gain_points(monkeypatch):
    monkeypatch.setattr(loop, "CURVE_POINTS", 6)
    monkeypatch.setattr(loop, "LEAST_BETWEEN", 1)
    run, seen = training(), []
    run_to_end(run, seen.append, lambda: False, lambda: None, lambda: 12.5)
    assert [p.iteration for p in seen] == list(range(1, 61)) and seen[-1].seconds_left == 0
    assert [p.phase for p in seen] == ["train"] * 45 + ["recover"] * 15
    assert run.curves.iteration == [10, 20, 30, 40, 50, 60] and run.curves.psnr == [12.5] * 6
    assert run.curves.count[-1] == run.model.count and run.seconds.keys() == {"train", "recover"}


def test_a_short_run_measures_few_points(monkeypatch):
    monkeypatch.setattr(loop, "LEAST_BETWEEN", 25)
    run, measured = training(), []
    run_to_end(run, lambda _: None, lambda: False, lambda: None, lambda: measured.append(run.iteration))
    assert measured == run.curves.iteration == [25, 50, 60]


def test_a_request_to_stop_leaves_a_checkpoint():
    run, saved = training(), []
    with pytest.raises(Cancelled):
        run_to_end(
            run, lambda p: None, lambda: run.iteration == 9, lambda: saved.append(run.iteration), lambda: None
        )
    assert saved == [9] and run.iteration == 9
