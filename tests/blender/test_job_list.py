"""All jobs that Blender knows: the queue, the list, jobs whose splat is gone or came back, and what is left
of finished jobs."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import COUNT, LONG, SHORT, Layout, delete, drawn, end_all, ended, follow, set_up


def discard_all():
    for parent in part("operators.data.job_paths").job_folders(bpy.context):
        for file in Path(parent).glob("*/job.json"):
            part("svrgs_addon.jobs.job_folder").JobFolder(file.parent).discard()


@pytest.fixture(autouse=True)
def nothing_is_left():
    """Of the jobs of other tests."""
    discard_all()


@pytest.fixture
def listed(watch):
    """The rows of the list by the name of the splat, read anew."""
    module = part("operators.jobs.job_list")

    def rows() -> dict:
        module.forget()
        return {row.name: row for row in part("operators.jobs.job_list").rows(bpy.context)}

    yield rows
    end_all(watch)
    discard_all()


@pytest.fixture
def two(splat, watch):
    """Two splats with a job each: one runs, one waits. ((splat, job), (splat, job))"""
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    other = bpy.context.object
    other.name = "other"
    set_up(SHORT | {"iterations": 300})
    for obj in (splat, other):
        bpy.context.view_layer.objects.active = obj
        bpy.ops.svrgs.job_start()
    return tuple(zip((splat, other), watch.jobs.values(), strict=True))


def new_file():
    """File > New."""
    folder = bpy.context.scene.svrgs_prune.folder
    bpy.ops.wm.read_homefile(use_empty=True)
    bpy.context.scene.svrgs_prune.folder, bpy.context.scene.svrgs_prune.data = folder, str(DATA / "tiny")


def import_again() -> bpy.types.Object:
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    return bpy.context.object


def folder_of(row) -> str:
    return str(row.job.folder.path)


# --- the queue


def test_a_second_job_waits_and_starts_when_the_first_has_ended(two, watch, results, listed):
    (splat, first), (other, second) = two
    assert first.running and not second.running and second.folder.state()["state"] == "queued"
    assert bpy.context.object == other and "Waiting for 'scene'. One job runs at a time" in drawn("prune")
    assert "svrgs.job_stop" in drawn("prune")
    assert listed()["other"].state == "Waiting for 'scene'" and listed()["scene"].state.startswith("Running")
    with pytest.raises(RuntimeError, match="Waiting for 'scene'"):
        bpy.ops.svrgs.job_start()
    follow(watch, lambda: second.running)
    assert first.state == "done"
    follow(watch, lambda: ended(second))
    assert results.pruned_of(splat) and results.pruned_of(other) and not watch.tick()


def test_a_quick_job_does_not_wait_for_a_long_one(two, watch, results):
    (_, first), (other, second) = two
    bpy.ops.svrgs.job_stop()
    assert not part("operators.jobs.job_queue").is_queued(second)
    bpy.ops.svrgs.job_discard()
    bpy.context.scene.svrgs_prune.effort = "QUICK"
    bpy.ops.svrgs.job_start()
    quick = watch.job_of(other)
    assert quick is not second and quick.running and first.running
    follow(watch, lambda: results.pruned_of(other))
    assert quick.state == "done"


def test_a_job_that_waits_can_run_now_and_the_other_goes_on_after_it(splat, watch, results, listed):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.context.object.name, other = "other", bpy.context.object
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    first, second = watch.jobs.values()
    follow(watch, lambda: first.facts.get("iteration", 0) > 20)
    assert "Waiting for 'scene', about" in drawn("prune") and "svrgs.job_run_now" in drawn("prune")
    assert bpy.ops.svrgs.job_run_now() == {"FINISHED"} and first.stopping
    assert part("operators.jobs.job_queue").is_queued(first) is False, "it stops first"
    with pytest.raises(RuntimeError, match="'scene' does not wait for another job"):
        bpy.ops.svrgs.job_run_now(folder=str(first.folder.path))
    follow(watch, lambda: results.pruned_of(other))
    follow(watch, lambda: first.running and first.facts.get("iteration", 0) > 20)
    assert first.folder.checkpoint() > 0 and listed()["scene"].state.startswith("Running")


@pytest.fixture
def long_and_short(splat, watch):
    """A long job that runs, and a short one that waits for it."""
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (first,) = watch.jobs.values()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: first.facts.get("iteration", 0) > 20)
    return first, watch.job_of(bpy.context.object)


@pytest.mark.parametrize("stopped", ["before", "after"])
def test_a_job_that_makes_way_and_is_stopped_does_not_go_on(long_and_short, watch, stopped):
    first, second = long_and_short
    if stopped == "before":
        bpy.ops.svrgs.job_stop(folder=str(first.folder.path))
        assert first.stopping
    bpy.ops.svrgs.job_run_now(folder=str(second.folder.path))
    if stopped == "after":
        bpy.ops.svrgs.job_stop(folder=str(first.folder.path), now=True)
    follow(watch, lambda: ended(second))
    assert first.state == "stopped" and not first.running and not watch.tick()


def test_one_line_tells_what_runs_and_how_it_ended(two, watch, results):
    (_, first), (other, _) = two
    lists, header = part("operators.jobs.job_list"), Layout()
    follow(watch, lambda: first.knows_progress)
    bpy.context.view_layer.objects.active = None
    assert re.fullmatch(r"scene: \d+%, .* left; 1 more", lists.headline(bpy.context))
    part("panels.jobs").draw_headline(SimpleNamespace(layout=header), bpy.context)
    assert header.text.startswith("scene: ")
    follow(watch, lambda: results.pruned_of(other))
    assert lists.headline(bpy.context) == "other: Finished"
    bpy.ops.wm.read_homefile(use_empty=True)
    assert lists.headline(bpy.context) == ""


def test_a_job_that_waits_can_be_taken_out_of_the_queue_and_put_back(two, watch):
    (_, first), (_, second) = two
    bpy.ops.svrgs.job_stop()
    assert "Not started yet Resume starts it from the beginning" in drawn("prune")
    assert "job_resume" in drawn("prune")
    bpy.ops.svrgs.job_resume()
    assert "Waiting for 'scene'" in drawn("prune")
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not first.running)
    assert not watch.tick() and second.state == "queued" and not second.running
    bpy.ops.svrgs.job_resume()
    assert second.running


def test_the_queue_goes_on_with_another_file_open(two, watch, listed):
    (_, first), (_, second) = two
    new_file()
    assert {row.size.partition(", ")[2] for row in listed().values()} == {"its splat is not in this file"}
    follow(watch, lambda: ended(second))
    assert first.state == "done" and {row.state for row in listed().values()} == {"Finished"}


def test_undo_changes_nothing_in_the_queue(splat, watch, results):
    other = import_again()
    other.name = "other"
    set_up(SHORT | {"iterations": 300})
    bpy.ops.ed.undo_push(message="before")
    for name in ("scene", "other"):
        bpy.context.view_layer.objects.active = bpy.data.objects[name]
        bpy.ops.svrgs.job_start("EXEC_DEFAULT", True)
    for _ in range(2):
        bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    first, second = watch.jobs.values()
    follow(watch, lambda: ended(second))
    assert all(results.pruned_of(bpy.data.objects[name]) for name in ("scene", "other"))


def test_a_job_that_cannot_start_does_not_stop_the_queue(two, watch):
    (_, first), (_, second) = two
    (second.folder / "job.json").write_text("{}")
    follow(watch, lambda: second.state == "failed")
    assert first.state == "done" and "is no job of this version" in second.facts["text"]


# --- the list


def test_a_job_whose_splat_was_deleted_is_listed_stopped_continued_and_opened(splat, watch, listed, bridge):
    set_up(SHORT | {"iterations": 800})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration", 0) > 100)
    delete(splat)
    new_file()
    row = listed()["scene"]
    assert row.actions == ("stop",) and row.state.startswith("Running at")
    assert row.size.endswith("its splat is not in this file")
    assert "svrgs.job_stop" in drawn("jobs")
    bpy.ops.svrgs.job_stop(folder=folder_of(row))
    follow(watch, lambda: not job.running)
    assert listed()["scene"].actions == ("resume", "discard")
    assert listed()["scene"].state.startswith("Stopped at")
    with pytest.raises(RuntimeError, match="has no result yet"):
        bpy.ops.svrgs.job_load(folder=folder_of(row))
    bpy.ops.svrgs.job_resume(folder=folder_of(row))
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    assert not bpy.data.objects and listed()["scene"].actions == ("load", "discard")
    bpy.ops.svrgs.job_load(folder=folder_of(row))
    assert bpy.context.object.name == "scene pruned" and bridge.count(bpy.context.object) == 125
    bpy.ops.svrgs.job_discard(folder=folder_of(row))
    assert not Path(folder_of(row)).exists() and not listed() and "There are no jobs" in drawn("jobs")


def test_jobs_of_earlier_sessions_are_found_in_the_folders(splat, watch, listed, tmp_path):
    """Those of an unsaved file are in the extension's folder, others beside the .blend file."""
    set_up(SHORT | {"folder": ""})
    bpy.ops.svrgs.job_start()
    (first,) = watch.jobs.values()
    follow(watch, lambda: not first.running)
    new_file()
    bpy.context.scene.svrgs_prune.folder = ""
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    import_again().name = "beside"
    set_up(SHORT | {"folder": ""})
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: all(map(ended, watch.jobs.values())))
    assert set(listed()) == {"scene", "beside"}
    assert Path(folder_of(listed()["beside"])).parent == tmp_path / "svrgs_jobs"
    assert part("svrgs_addon.system.memory").size_text(first.folder.size()) in listed()["scene"].size


def test_a_result_is_opened_beside_its_splat_where_that_is(splat, watch, listed, results):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.object.mode_set(mode="EDIT")
    follow(watch, lambda: not job.running)
    folder = folder_of(listed()["scene"])
    with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
        bpy.ops.svrgs.job_load(folder=folder)
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.svrgs.job_load(folder=folder)
    assert results.pruned_of(splat) == bpy.context.object
    assert listed()["scene"].state == "Finished, its result is in this file"
    assert listed()["scene"].actions == ("discard",)


def test_a_job_that_runs_is_not_deleted(splat, watch, listed):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    with pytest.raises(RuntimeError, match="'scene' runs or waits: stop it first"):
        bpy.ops.svrgs.job_discard(folder=str(job.folder.path))
    assert job.running and job.folder.path.exists()


def test_a_folder_with_a_broken_job_is_listed_and_can_be_deleted(splat, watch, listed):
    parent = Path(bpy.context.scene.svrgs_prune.folder)
    for name, content in (("broken", "{"), ("none", "")):
        (parent / name).mkdir(parents=True)
        (parent / name / "job.json").write_text(content)
    (parent / "not a job").mkdir()
    assert set(listed()) == {"broken", "none"} and drawn("jobs")
    with pytest.raises(RuntimeError, match="is no job of this version"):
        bpy.ops.svrgs.job_resume(folder=str(parent / "broken"))
    bpy.ops.svrgs.job_discard(folder=str(parent / "broken"))
    assert set(listed()) == {"none"} and (parent / "not a job").exists()
    with pytest.raises(RuntimeError, match="holds no job any more"):
        bpy.ops.svrgs.job_discard(folder=str(parent / "broken"))


def test_finished_jobs_are_deleted_together_but_not_what_is_still_to_be_loaded(two, watch, listed, results):
    (splat, first), (other, second) = two
    set_up(SHORT)
    follow(watch, lambda: ended(first))
    bpy.ops.object.mode_set(mode="EDIT")
    follow(watch, lambda: ended(second))
    bpy.ops.object.mode_set(mode="OBJECT")
    assert results.pruned_of(splat) and not results.pruned_of(other)
    listed()
    assert part("operators.jobs.job_list").finished_text(bpy.context).startswith("Delete 1 Finished, ")
    bpy.ops.svrgs.delete_finished_jobs()
    assert not first.folder.path.exists() and second.folder.path.exists() and set(listed()) == {"other"}


# --- a splat that comes back


@pytest.mark.parametrize("state", ["stopped", "done", "running"])
def test_a_splat_that_is_imported_again_takes_its_job_over(splat, watch, results, bridge, state):
    set_up(SHORT | {"iterations": 40 if state == "done" else 800})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    if state != "done":
        follow(watch, lambda: job.facts.get("iteration", 0) > 5)
        if state == "stopped":
            bpy.ops.svrgs.job_stop()
    if state != "running":
        delete(splat)
        follow(watch, lambda: not job.running)
    new_file()
    splat = import_again()
    splat.name = "again"
    assert "A job of this splat was found:" in drawn("prune") and "svrgs.adopt_job" in drawn("prune")
    bpy.ops.svrgs.adopt_job()
    assert watch.current(bpy.context)[0] == splat and "A job of this splat was found" not in drawn("prune")
    if state == "done":
        bpy.ops.svrgs.job_load()
    elif state == "stopped":
        bpy.ops.svrgs.job_resume()
    follow(watch, lambda: results.pruned_of(splat))
    assert bridge.count(results.pruned_of(splat)) == 125


def test_a_job_of_other_gaussians_is_not_offered(splat, watch, bridge):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: not job.running)
    new_file()
    splat = import_again()
    scene = bridge.scene_from_object(splat)
    scene.means[7] += np.float32(1e-3)
    bridge.replace_gaussians(splat, scene)
    bpy.context.view_layer.update()
    assert "was found" not in drawn("prune")
    with pytest.raises(RuntimeError, match="No job of this splat was found"):
        bpy.ops.svrgs.adopt_job()
    fewer = import_again()
    bridge.replace_gaussians(fewer, bridge.scene_from_object(fewer).select(np.arange(99)))
    assert "was found" not in drawn("prune")


def test_an_edit_after_the_job_was_offered_is_noticed(splat, watch, bridge):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: not job.running)
    new_file()
    splat = import_again()
    assert "was found" in drawn("prune")
    bridge.set_values(splat, "position", "FLOAT_VECTOR", bridge.values(splat, "position") + np.float32(1))
    bpy.context.view_layer.update()
    assert "was found" not in drawn("prune")


def test_the_same_splat_imported_twice_is_not_offered_the_job_of_the_first(splat, watch):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    other = import_again()
    assert "was found" not in drawn("prune") and bpy.ops.svrgs.job_start.poll()
    bpy.context.view_layer.objects.active = other
    with pytest.raises(RuntimeError, match="No job of this splat was found"):
        bpy.ops.svrgs.adopt_job()


# --- what is left of finished jobs


def test_the_files_of_an_applied_job_go_when_the_file_is_saved(pruned, watch, listed, bridge, tmp_path):
    (job,) = watch.jobs.values()
    original, result = pruned
    names = original.name, result.name
    bpy.ops.svrgs.apply()
    assert job.folder.path.exists(), "a crash now would lose the result"
    assert listed()["scene"].state == "Finished: its files are deleted when the file is saved"
    assert not part("operators.jobs.job_list").finished_text(bpy.context)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "copy.blend"), copy=True)
    assert job.folder.path.exists(), "the result is not in this file yet"
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    assert not job.folder.path.exists() and not listed()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    original, result = (bpy.data.objects[name] for name in names)
    assert bridge.count(result) == 125 and bridge.count(original) == COUNT and "svrgs_job" not in original


@pytest.mark.parametrize("saved", [False, True])
def test_undo_of_apply_needs_no_files(pruned, watch, results, bridge, tmp_path, saved):
    (job,) = watch.jobs.values()
    names = [obj.name for obj in pruned]
    bpy.ops.ed.undo_push(message="before")
    pruned[1].svrgs_share = 20
    bpy.ops.ed.undo_push(message="fewer")
    bpy.ops.svrgs.apply()
    bpy.ops.ed.undo_push(message="applied")
    if saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    bpy.ops.ed.undo()
    bpy.context.view_layer.update()
    original, result = (bpy.data.objects[name] for name in names)
    assert results.undecided(result) and results.shown_count(result) == 50 and bridge.count(result) == 125
    assert job.folder.path.exists() != saved and "50 of 250 Gaussians" in drawn("prune")
    if not saved:
        bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
        assert job.folder.path.exists(), "it is not applied now"
        assert watch.job_of(original).state == "done"
    bpy.ops.ed.redo()
    bpy.context.view_layer.update()
    original, result = (bpy.data.objects[name] for name in names)
    assert bridge.count(result) == 50 and watch.current(bpy.context) is None and not results.undecided(result)
    bpy.context.view_layer.objects.active = original
    assert watch.current(bpy.context) is None and bpy.ops.svrgs.job_start.poll()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    assert not job.folder.path.exists()


def test_the_files_of_an_applied_result_that_was_deleted_stay(pruned, watch, tmp_path):
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.apply()
    delete(pruned[1])
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    assert job.folder.path.exists()
