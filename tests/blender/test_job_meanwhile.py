"""What a user does while a job is at work or its result undecided: undo, delete, copy, link; and what breaks
meanwhile."""

from __future__ import annotations

import shutil
import sys

import bpy
import pytest
from extension import DATA, part
from job_helpers import COUNT, LONG, SHORT, delete, drawn, ended, follow, marked, set_up


def undo(times: int = 1):
    for _ in range(times):
        bpy.ops.ed.undo()
    bpy.context.view_layer.update()


def start(**options):
    """Starts a job as the button does, with a step of undo where the operator has one."""
    set_up(options)
    bpy.ops.ed.undo_push(message="before")
    bpy.ops.svrgs.job_start("EXEC_DEFAULT", True)


@pytest.mark.parametrize("times", [1, 2])
def test_undo_leaves_a_running_job_to_its_splat(splat, watch, results, times):
    start(**SHORT | {"iterations": 400})
    bpy.context.object.location.x = 3
    bpy.ops.ed.undo_push(message="moved")
    undo(times)
    splat = bpy.data.objects["scene"]
    assert splat.location.x == 0 and watch.current(bpy.context)[0] == splat and "job_stop" in drawn("prune")
    bpy.ops.ed.redo()
    follow(watch, lambda: results.pruned_of(bpy.data.objects["scene"]))


def test_undo_of_what_arrived_leaves_the_result_to_be_loaded(splat, watch, results):
    start(**SHORT)
    follow(watch, lambda: len(bpy.data.objects) == 2)
    bpy.ops.ed.undo_push(message="arrived")
    undo()
    assert len(bpy.data.objects) == 1 and watch.current(bpy.context)[1].state == "done"
    bpy.ops.svrgs.job_load()
    assert results.pruned_of(bpy.data.objects["scene"])


def test_undo_does_not_bring_a_discarded_job_back(splat, watch):
    start(**LONG)
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    bpy.ops.svrgs.job_discard()
    bpy.ops.ed.undo_push(message="discarded")
    undo()
    assert watch.current(bpy.context) is None and bpy.ops.svrgs.job_start.poll()


def test_a_started_job_is_a_step_of_undo(splat, watch):
    start(**LONG)
    bpy.context.object.location.x = 3
    bpy.ops.ed.undo_push(message="moved")
    part("operators.data.known").objects.clear()  # nothing but that step remembers it
    undo()
    assert watch.current(bpy.context)[0] == bpy.data.objects["scene"]


def another_job(splat, watch) -> tuple:
    """Starts a job of the splat and one of another, which waits; (that splat, the first job, the other)."""
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    other = bpy.context.object
    set_up(SHORT)
    for obj in (splat, other):
        bpy.context.view_layer.objects.active = obj
        bpy.ops.svrgs.job_start()
    return other, *watch.jobs.values()


def test_a_splat_deleted_meanwhile_stops_no_other_job(splat, watch, results):
    other, first, second = another_job(splat, watch)
    keep = bpy.data.scenes.new("keeps a pointer to it")
    keep["splat"] = splat
    delete(splat)
    follow(watch, lambda: ended(second))
    assert first.state == second.state == "done" and results.pruned_of(other) and not results.pruned_of(splat)
    bpy.data.scenes.remove(keep)


def test_a_result_arrives_where_its_collection_is_excluded(splat, watch, results):
    collection = bpy.data.collections.new("aside")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(splat)
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    bpy.context.view_layer.layer_collection.children["aside"].exclude = True
    (job,) = watch.jobs.values()
    follow(watch, lambda: not job.running)
    result = results.pruned_of(splat)
    assert job.state == "done" and result.svrgs_share == pytest.approx(50)
    assert results.pair_of(result) == (splat, result)


@pytest.mark.skipif(sys.platform == "win32", reason="Windows keeps files that are open")
@pytest.mark.parametrize("what", ["follow", "stop"])
def test_a_job_whose_folder_was_deleted_fails_in_a_sentence(splat, watch, what):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration", 0) > 5)
    process = job._process
    shutil.rmtree(job.folder.path, ignore_errors=True)  # the process writes meanwhile
    if what == "stop":
        bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    assert process.poll() is not None and not watch.tick()
    assert job.state == "failed" and "messages.jsonl" in job.facts["text"] and "Failed" in drawn("prune")
    assert "Failed" in part("operators.jobs.job_list").headline(bpy.context)
    assert "Resume cannot continue it, as its files are gone" in drawn("prune")
    with pytest.raises(RuntimeError, match="is no job of this version"):
        bpy.ops.svrgs.job_resume()
    bpy.ops.svrgs.job_discard()
    assert bpy.ops.svrgs.job_start.poll() and not watch.jobs


def test_a_full_disk_stops_no_other_job(splat, watch, monkeypatch):
    folder = part("svrgs_addon.jobs.job_folder")
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()

    def full(*_):
        raise part("svrgs_addon.system.errors").SceneError("state.json: No space left on device")

    monkeypatch.setattr(folder.JobFolder, "write_json", full)
    job._process.kill()
    follow(watch, lambda: not job.running)
    assert job.state == "interrupted" and "Interrupted" in drawn("prune") and not watch.tick()


def test_trouble_of_one_job_leaves_the_others_running(splat, watch, results, monkeypatch):
    other, first, second = another_job(splat, watch)

    def broken():
        raise MemoryError

    monkeypatch.setattr(first, "poll", broken)
    follow(watch, lambda: ended(second))
    assert first.state == "failed" and first.facts["text"] == "MemoryError" and not first.running
    assert results.pruned_of(other) and not results.pruned_of(splat)


@pytest.fixture
def linked(splat, tmp_path):
    """A splat that lies in another file."""
    bpy.data.libraries.write(str(tmp_path / "asset.blend"), {splat})
    bpy.data.batch_remove([splat])
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True) as (there, here):
        here.objects = there.objects
    (obj,) = here.objects
    bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = obj
    yield obj
    bpy.data.libraries.remove(obj.library)


def test_a_linked_splat_is_not_pruned_in_vain(linked):
    for operator in (bpy.ops.svrgs.job_start, bpy.ops.svrgs.estimate, bpy.ops.svrgs.contribution):
        with pytest.raises(RuntimeError, match="is linked from another file: make it local first"):
            operator()
    with pytest.raises(RuntimeError, match="is linked from another file: make it local first"):
        bpy.ops.svrgs.prune(data=str(DATA / "tiny"), iterations=5, recovery=0)
    assert list(bpy.data.objects) == [linked] and "make it local first" in drawn("prune")


def test_a_result_that_is_linked_is_not_applied(pruned, tmp_path):
    bpy.data.libraries.write(str(tmp_path / "asset.blend"), set(pruned))
    bpy.data.batch_remove(list(bpy.data.objects))
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True) as (there, here):
        here.objects = there.objects
    for obj in here.objects:
        bpy.context.collection.objects.link(obj)
    bpy.context.view_layer.objects.active = bpy.data.objects["scene pruned"]
    with pytest.raises(RuntimeError, match="is linked from another file: make it local first"):
        bpy.ops.svrgs.apply()
    bpy.data.libraries.remove(here.objects[0].library)


def test_a_linked_original_is_left_as_it_is(pruned, bridge, tmp_path):
    bpy.data.libraries.write(str(tmp_path / "asset.blend"), set(pruned))
    bpy.data.batch_remove(list(bpy.data.objects))
    with bpy.data.libraries.load(str(tmp_path / "asset.blend"), link=True) as (_, here):
        here.objects = ["scene"]
    (original,) = here.objects
    bpy.context.collection.objects.link(original)
    bpy.context.view_layer.update()
    assert "svrgs_pruned" in original and original.modifiers and marked(bridge, original).sum() == 125
    bpy.data.libraries.remove(original.library)


def duplicate(obj, linked: bool = False) -> bpy.types.Object:
    """As with Shift+D, or Alt+D."""
    bpy.ops.object.select_all(action="DESELECT")
    obj.select_set(True)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.object.duplicate(linked=linked)
    bpy.context.view_layer.update()
    return bpy.context.object


def test_a_copy_of_a_result_is_applied_by_itself(pruned, bridge, results):
    original, result = pruned
    copy = duplicate(result)
    assert results.pair_of(copy) == (None, copy) and results.pair_of(original) == (original, result)
    copy.svrgs_share = 40
    bpy.ops.svrgs.apply()
    assert bridge.count(copy) == 50
    bpy.context.view_layer.objects.active = result
    assert results.shown_count(result) == 125 and "125 of 250 Gaussians" in drawn("prune")
    result.svrgs_share = 20
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 50


@pytest.mark.parametrize("linked", [False, True])
def test_a_copy_of_the_original_is_a_splat_of_its_own(pruned, results, linked):
    original, result = pruned
    result.svrgs_share = 80  # the original is the one that is shown
    copy = duplicate(original, linked)
    assert results.pair_of(copy) == (None, None) and results.pair_of(result) == (original, result)
    assert "removed" in original.data.attributes and results.shown_count(result) == 200
    assert not copy.modifiers and (linked or "removed" not in copy.data.attributes)
    visible = part("operators.data.visible_splats").visible_scene
    assert (visible(original).count, visible(copy).count) == (200, COUNT)


def test_a_copy_of_a_splat_has_no_part_in_its_job(splat, watch):
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    copy = duplicate(splat)
    assert "svrgs_job" not in copy and watch.current(bpy.context) is None and bpy.ops.svrgs.job_start.poll()
    bpy.context.view_layer.objects.active = splat
    assert watch.current(bpy.context) == (splat, job)
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    bpy.context.view_layer.objects.active = copy
    with pytest.raises(RuntimeError, match="There is no job"):
        bpy.ops.svrgs.job_discard()
    assert job.folder.path.exists()


def test_a_linked_duplicate_keeps_its_gaussians(splat, watch, results):
    bpy.ops.object.duplicate(linked=True)
    twin = bpy.context.object
    bpy.context.view_layer.objects.active = splat
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: results.pruned_of(splat))
    visible = part("operators.data.visible_splats").visible_scene
    assert (visible(splat).count, visible(twin).count) == (COUNT // 2, COUNT)


@pytest.mark.parametrize("error", [MemoryError(), RuntimeError("no more")])
def test_a_result_that_cannot_be_loaded_stays_one_to_be_loaded(
    splat, watch, results, monkeypatch, error, capfd
):
    def fail(*_):
        raise error

    set_up(SHORT)
    with monkeypatch.context() as patch:
        patch.setattr(results, "load", fail)
        bpy.ops.svrgs.job_start()
        (job,) = watch.jobs.values()
        follow(watch, lambda: ended(job))
    assert job.state == "done" and "svrgs.job_load" in drawn("prune") and results.pruned_of(splat) is None
    assert type(error).__name__ in capfd.readouterr().err
    assert bpy.ops.svrgs.job_load() == {"FINISHED"} and results.pruned_of(splat)


def test_the_panel_shows_another_splats_job_only_where_none_is_active(splat, watch):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    other = bpy.context.object
    bpy.context.view_layer.objects.active = splat
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    bpy.context.view_layer.objects.active = other
    assert "svrgs.job_start" in drawn("prune") and "svrgs.job_stop" not in drawn("prune")
    bpy.ops.object.camera_add()
    assert "svrgs.job_stop" in drawn("prune")


def test_applied_outside_the_view_layer(pruned, bridge):
    original, result = pruned
    collection = bpy.data.collections.new("aside")
    bpy.context.scene.collection.children.link(collection)
    collection.objects.link(result)
    bpy.context.scene.collection.objects.unlink(result)
    bpy.context.view_layer.layer_collection.children["aside"].exclude = True
    original.hide_set(False)
    bpy.context.view_layer.objects.active = original
    bpy.ops.svrgs.apply()
    assert bridge.count(result) == 125 and not result.modifiers and bpy.context.object == original


def test_in_edit_mode_no_result_is_loaded(splat, watch):
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.object.mode_set(mode="EDIT")
    follow(watch, lambda: not job.running)
    for operator in (bpy.ops.svrgs.job_load, bpy.ops.svrgs.contribution):
        with pytest.raises(RuntimeError, match="Leave Edit Mode first"):
            operator()
    assert list(bpy.data.objects) == [splat]
    bpy.ops.object.mode_set(mode="OBJECT")
    bpy.ops.svrgs.job_load()
    assert len(bpy.data.objects) == 2
