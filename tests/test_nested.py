"""Nested results (`svrgs prune --nested`, `--levels`): smaller numbers of Gaussians are trained, ordered and
written."""

import json
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
import tiny_dataset
import whole_jobs
from command_checks import files, refused
from job_checks import create, follow
from pictures import photographed
from plans import prune_settings
from short_runs import bits, disturbed, to_the_end
from svrgs_addon.cli.batch_list import expand
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.nested import SIZES, nested_order, size_of_step, smaller_sizes
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.saliency import removal_errors
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.recipes.fine_tuned import refuse_lost_order
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system.errors import Cancelled, SceneError

COUNT, SMALLEST = 60, 0.1
SETTINGS = prune_settings("removal", 16, 60, nested=SMALLEST, target=40)
SHORT = ("--iterations", 8, "--recovery", 16, "--quiet")


def run_of(settings=SETTINGS, engine=None) -> Run:
    scene = scenes.random_scene(COUNT, 2, 1, spread=1.2, scale=0.3, opacity=2.0)
    return Run(Model.of(disturbed(scene)), photographed(scene), settings, engine or NativeEngine())


def until(run: Run, iteration: int) -> Run:
    while run.iteration < iteration:
        run.advance()
    return run


# --- order and steps


def test_sizes_fall_by_the_same_ratio_to_the_smallest():
    sizes = smaller_sizes(100_000, SMALLEST)
    assert len(sizes) == SIZES and sizes[-1] == 10_000
    np.testing.assert_allclose(np.array([100_000, *sizes[:-1]]) / sizes, SMALLEST ** (-1 / SIZES), rtol=1e-4)
    assert smaller_sizes(1, SMALLEST) == [1] * SIZES


def test_an_allowed_drop_is_not_spent_in_a_nested_recovery():
    """Its smaller sizes are parts of what the recovery begins with."""
    for nested in (SMALLEST, 0.0):
        run = until(run_of(replace(SETTINGS, target=0, max_loss=1.0, nested=nested)), 16)
        begun = run.model.count
        to_the_end(run)
        assert (run.model.count == begun) == bool(nested)


def test_the_most_important_come_first():
    """Of each size, the first rows are those of highest removal error, measured with the next larger size."""
    run = until(run_of(), 16)
    order = nested_order(run)
    assert sorted(order) == list(range(40))
    kept = np.ones(40, bool)
    for size in smaller_sizes(40, SMALLEST):
        error = removal_errors(run.viewed, kept)
        first = np.isin(np.arange(40), order[:size])
        assert kept[first].all() and error[first].min() >= error[kept & ~first].max(initial=0)
        kept = first
    run.close()


def test_half_of_the_steps_of_the_recovery_train_fewer_gaussians():
    first, recover = SETTINGS.phases
    sizes = [size_of_step(SETTINGS, recover, iteration, 1_000) for iteration in range(4_000)]
    assert set(sizes) == {1_000, *smaller_sizes(1_000, SMALLEST)}
    assert np.mean(np.array(sizes) == 1_000) == pytest.approx(0.5, abs=0.05)
    assert {size_of_step(SETTINGS, first, iteration, 1_000) for iteration in range(100)} == {1_000}
    assert {
        size_of_step(replace(SETTINGS, nested=0.0), recover, iteration, 1_000) for iteration in range(100)
    } == {1_000}


def test_a_step_changes_the_first_rows_alone():
    """Without the mean that takes the place of the values after the last step."""
    run = until(
        run_of(replace(SETTINGS, phases=tuple(replace(phase, averaged=0.0) for phase in SETTINGS.phases))), 17
    )
    changed = set()
    while not run.finished:
        size = size_of_step(SETTINGS, run.phase()[0], run.iteration, run.model.count)
        before = {name: run.model.values[name].copy() for name in PARAMETERS}
        run.advance()
        for name in PARAMETERS:
            np.testing.assert_array_equal(run.model.values[name][size:], before[name][size:])
            assert (run.model.values[name][:size] != before[name][:size]).any()
        changed.add(size)
    run.close()
    assert len(changed) > SIZES / 2


@pytest.mark.slow
def test_smaller_numbers_of_gaussians_look_better_than_without():
    first, recover = SETTINGS.phases
    phases = (first, replace(recover, steps=600))
    run = to_the_end(run_of(replace(SETTINGS, phases=phases)))
    plain = to_the_end(run_of(replace(SETTINGS, phases=phases, nested=0.0)))
    plain.plan = run.plan
    order = nested_order(plain)
    for count in (20, 10):
        assert picture_of(run, np.arange(count)) > picture_of(plain, order[:count]) + 1


def picture_of(run: Run, rows: np.ndarray) -> float:
    """PSNR in dB with these Gaussians alone."""
    return run.quality(np.isin(np.arange(run.model.count), rows))


def test_both_engines_train_the_first_rows():
    torch_engine = pytest.importorskip("svrgs_addon.finetune.torch_engine")
    native, torch = until(run_of(), 17), until(run_of(engine=torch_engine.TorchEngine()), 17)
    for name in PARAMETERS:
        torch.model.values[name][:] = native.model.values[name]
        torch.model.moments[name][:] = native.model.moments[name]
    while size_of_step(SETTINGS, native.phase()[0], native.iteration, 40) == 40:
        native.iteration = torch.iteration = native.iteration + 1
    native.advance(), torch.advance()
    for name in PARAMETERS:
        np.testing.assert_allclose(torch.model.values[name], native.model.values[name], atol=2e-4)
    native.close(), torch.close()


@pytest.mark.parametrize("iteration", [10, 30])
def test_a_stopped_run_ends_as_if_it_had_not_been(tiny, data, tmp_path, iteration):
    settings = prune_settings("removal", 16, 30, nested=SMALLEST, target=100)
    asked = []

    def stop() -> bool:
        asked.append(0)
        return len(asked) == iteration

    whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / "whole.ply"))
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / "o.ply", stop=stop))
    whole_jobs.prune(tiny.splat, data, settings, JobContext(tmp_path / "o.ply", resume=True))
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_without_it_nothing_changes():
    plain = replace(SETTINGS, nested=0.0)
    assert bits(to_the_end(run_of(plain)).model) == bits(
        to_the_end(run_of(prune_settings("removal", 16, 60, target=40))).model
    )


# --- levels of detail on the command line


def test_levels_are_the_first_rows_of_the_output(tiny, svrgs, tmp_path):
    words = f"--target 0.4 --levels 0.5,0.125 --json --out {tmp_path}/o.ply"
    levels = svrgs("prune", tiny.splat, "--data", tiny.folder, *SHORT, words).json["levels"]
    assert sorted(files(tmp_path)) == ["o.ply", "o_12.5.ply", "o_50.ply"]
    whole = read_ply(tmp_path / "o.ply")
    for level, count in zip(levels, (50, 12), strict=True):
        scene = read_ply(level["out"])
        assert scene.count == level["count"] == count and level["psnr"] > 0
        for name in PARAMETERS:
            np.testing.assert_array_equal(getattr(scene, name), getattr(whole, name)[:count])


def test_what_cannot_be_is_one_sentence(tiny, svrgs, tmp_path):
    words = ["prune", tiny.splat, "--data", tiny.folder, "--target", 0.4, "--out", tmp_path / "o.ply"]
    refused(svrgs(*words, "--nested", 0.1, "--recovery", 0), "give --recovery a number above 0")
    refused(
        svrgs(*words, "--levels", "0.5,0.5"),
        "is not shares above 0 and below 1 with commas between, each once",
    )
    refused(svrgs(*words, "--levels", "0.3333333,0.33333331"), "each once")  # their files would have one name
    refused(svrgs(*words, "--levels", "1"), "is not shares above 0 and below 1")
    refused(svrgs(*words, "--nested", 1), "is not a share above 0 and below 1")
    assert not list(tmp_path.iterdir())


def test_a_level_is_never_the_input(tiny, svrgs, tmp_path):
    source = tmp_path / "o_50.ply"
    source.write_bytes(tiny.splat.read_bytes())
    refused(
        svrgs("prune", source, "--data", tiny.folder, "--levels", "0.5", "--out", tmp_path / "o.ply"),
        "o_50.ply: is the input itself",
    )
    assert source.read_bytes() == tiny.splat.read_bytes() and list(tmp_path.iterdir()) == [source]


def test_a_finished_scene_without_its_levels_is_not_passed_over_in_silence(tiny, svrgs, tmp_path):
    (tmp_path / "o.ply").touch()
    done = svrgs(
        "prune", tiny.splat, "--data", tiny.folder, "--levels", "0.5", "--batch", "--out", tmp_path / "o.ply"
    )
    assert json.loads(done.out)["skipped"] == "the output exists, not all its levels: add --overwrite"
    assert done.status == 0


def test_a_level_never_replaces_a_scene(tmp_path):
    for name in ("a.ply", "a_pruned_50.spz", "a_50.spz"):
        (tmp_path / name).touch()
    a, level, other = (tmp_path / name for name in ("a.ply", "a_pruned_50.spz", "a_50.spz"))
    with pytest.raises(SceneError, match="a_pruned_50.spz: is both a scene to prune and an output of"):
        expand([a, level], None, None, levels=(0.5,))
    with pytest.raises(SceneError, match="a_50.spz: would be an output of both"):
        expand([a, other], None, tmp_path / "out", levels=(0.5,))
    assert len(expand([a, other], None, tmp_path / "out", levels=(0.25,))) == 2


def test_levels_are_not_taken_for_scenes(tmp_path):
    for name in ("scene.ply", "scene_pruned.ply", "scene_pruned_12.5.ply"):
        (tmp_path / name).touch()
    assert [item.scene.name for item in expand([tmp_path], None, None)] == ["scene.ply"]


# --- the ranking of a background job


def test_a_job_ranks_its_result_as_it_was_trained(tiny, tmp_path):
    job = Job(create(tmp_path / "job", tiny, iterations=16, recovery=40, target=0.4, nested=0.1))
    job.start(), follow(job)
    assert job.state == "done", job.folder.log_tail()
    kept, score = job.folder.arrays()
    pruned = read_ply(job.folder / "pruned.ply")
    by_score, cut = np.argsort(-score[kept]), round(0.25 * tiny_dataset.COUNT * 0.4)
    ours, others = (psnr_of(pruned.select(rows), tiny) for rows in (by_score[:cut], by_score[-cut:]))
    assert ours > others + 1, "the first ones are those that the steps with few Gaussians trained"


def psnr_of(scene, tiny) -> float:
    rasterizer = Rasterizer()
    renders = (
        (rasterizer.forward(scene, c)["rgb"].clip(0, 1), rasterizer.forward(tiny.truth, c)["rgb"].clip(0, 1))
        for c in tiny.cameras
    )
    return float(-10 * np.log10(np.mean([np.mean((a - b) ** 2) for a, b in renders])))


def test_levels_are_files_of_their_own_where_a_format_keeps_no_order(tmp_path):
    plan, job = prune_settings("removal", 16, 60, nested=0.5), JobContext(tmp_path / "a.spz")
    with pytest.raises(SceneError, match="an order of its own"):
        refuse_lost_order(plan, job)
    refuse_lost_order(plan, replace(job, levels=(0.5,)))
