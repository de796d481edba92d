"""A job by blocks on photographs that was stopped goes on where it was: with the tasks that are left, and
within a block from a checkpoint."""

from __future__ import annotations

import contextlib
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from block_checks import ready
from job_checks import create
from plans import prune_settings
from svrgs_addon.finetune import checkpoint, loop
from svrgs_addon.finetune.run import Run
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.prune import pipeline
from svrgs_addon.prune.blocks.folder import refuse_foreign, remove
from svrgs_addon.prune.blocks.learning import RUNS, decide, recover
from svrgs_addon.prune.blocks.tasks import FILE, progress
from svrgs_addon.prune.blocks.tuning import CUT, TUNED
from svrgs_addon.system.errors import Cancelled, FormatError, MemoryShort, SceneError
from svrgs_addon.views.dataset import load_dataset


@pytest.fixture
def short(monkeypatch):
    def refuse(*_):
        raise MemoryShort("a.ply: fine-tuning needs 90 GB of memory, but only 1 GB is available")

    monkeypatch.setattr(pipeline.FineTuned, "open", refuse)


@pytest.fixture
def steps(monkeypatch) -> list[int]:
    """The steps that runs do."""
    done, advance = list[int](), Run.advance

    def note(run: Run):
        done.append(run.iteration)
        advance(run)

    monkeypatch.setattr(Run, "advance", note)
    return done


def stopping(at: float):
    """Stops a task at this share of it."""

    def tell(_: str, share: float):
        if share >= at:
            raise Cancelled

    return tell


def files_of(folder: Path) -> dict[str, bytes]:
    return {
        path.name: path.read_bytes()
        for path in folder.glob("[0-9]*")
        if path.suffix in (".geometry", ".sh", ".rows")
    }


@pytest.mark.parametrize("method", ["removal", "svr"])
def test_a_task_that_was_stopped_goes_on_within_its_block(tiny, data, tmp_path, steps, method):
    plan = prune_settings(method, 40, 30, full=False, lambda_f=1e-3)
    whole, parts = (ready(tiny.splat, data, tmp_path / name, 130) for name in ("whole", "parts"))
    for task, more, folder in ((decide, (60,), CUT), (recover, (), TUNED)):
        steps.clear()
        for number in (0, 1):
            task(whole, number, data, plan, *more)
        done = len(steps)
        steps.clear()
        with pytest.raises(Cancelled):
            task(parts, 0, data, plan, *more, stopping(0.8))
        assert 10 < len(steps) < done // 2 and list(tmp_path.glob("parts/**/manifest.json"))
        for number in (0, 1):
            task(parts, number, data, plan, *more)
        assert len(steps) == done, "no step is done twice"
        assert files_of(tmp_path / "whole" / folder) == files_of(tmp_path / "parts" / folder)
        assert not list(tmp_path.glob(f"parts/**/{RUNS}/*")), "what is done needs no checkpoint"


def test_a_checkpoint_of_other_settings_or_photographs_is_not_taken(tiny, tmp_path, steps):
    shutil.copytree(tiny.folder, tmp_path / "data")
    data = load_dataset(tmp_path / "data")
    divided = ready(tiny.splat, data, tmp_path / "work", 130)
    plan = prune_settings("removal", 40, 0, full=False)
    for change in ({"seed": 7}, {}):
        with pytest.raises(Cancelled):
            decide(divided, 0, data, replace(plan, **change), 60, stopping(0.8))
    steps.clear()
    photograph = data.photos[data.train_indices[3]].path
    os.utime(photograph, ns=(1, 1))
    decide(divided, 0, data, plan, 60)
    assert len(steps) == 40, "from the beginning"


def test_a_disk_that_is_full_costs_the_checkpoint_alone(tiny, data, tmp_path, monkeypatch, caplog):
    divided = ready(tiny.splat, data, tmp_path / "work", 130)
    plan = prune_settings("removal", 20, 0, full=False)

    def full(*_):
        raise SceneError("arrays.npz: needs 1 GB, but only 1 MB are free")

    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0)
    monkeypatch.setattr(checkpoint, "save", full)
    decide(divided, 0, data, plan, 60)
    assert "the block 0 goes on without a checkpoint" in caplog.text
    assert (tmp_path / "work" / CUT / "0.rows").stat().st_size == 60 * 4


GOALS = {"target": ["--target", 0.5], "drop": ["--max-drop", 2.0]}


@pytest.mark.slow
@pytest.mark.parametrize("goal, step, at", [
    ("target", "decide", 3.7 / 6), ("target", "recover", 4.7 / 6), ("target", "recover", 0.0),
    ("target", "measure", 0.0), ("drop", "decide", 4.7 / 7),
])  # fmt: skip
def test_a_job_that_was_stopped_goes_on_with_resume(
    svrgs, short, stop_at, tiny, tmp_path, steps, goal, step, at
):
    words = ["prune", tiny.splat, "--data", tiny.folder, *GOALS[goal], "--iterations", 40, "--recovery", 20]
    assert svrgs(*words, "--out", tmp_path / "whole.ply").status == 0
    done = len(steps)
    steps.clear()
    stop_at(step, at)
    stopped = svrgs(*words, "--out", tmp_path / "o.ply")
    assert stopped.status == 130 and "continue from the last checkpoint with --resume" in stopped.err
    assert (tmp_path / "o.ply").exists() == (step == "measure")
    assert progress(tmp_path / "o.ply.blocks")[0] >= 3
    result = svrgs(*words, "--out", tmp_path / "o.ply", "--resume", "--json").json
    assert len(steps) == done and result["scene"] == str(tiny.splat)
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["o.ply", "whole.ply"]


@pytest.fixture
def whole_and_stopped(svrgs, short, stop_at, tiny, tmp_path, monkeypatch) -> list:
    """The words of a job. Memory was too short for it: whole.ply is its result by blocks; another start was
    stopped, and o.ply would be its output. Memory suffices from here on."""
    words = f"prune {tiny.splat} --data {tiny.folder} --target 0.5 --iterations 40 --recovery 20".split()
    assert svrgs(*words, "--out", tmp_path / "whole.ply").status == 0
    stop_at("recover")
    assert svrgs(*words, "--out", tmp_path / "o.ply").status == 130 and (tmp_path / "o.ply.blocks").is_dir()
    monkeypatch.undo()
    return words


def test_what_was_begun_by_blocks_goes_on_by_blocks(svrgs, whole_and_stopped, tmp_path, caplog):
    assert svrgs(*whole_and_stopped, "--out", tmp_path / "o.ply", "--resume").status == 0
    assert "its blocks are there from an earlier start; it is pruned by blocks" in caplog.text
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()
    assert not (tmp_path / "o.ply.blocks").exists()


def test_a_job_that_begins_again_leaves_no_blocks(svrgs, whole_and_stopped, tmp_path):
    (tmp_path / "p.ply.blocks").mkdir()
    (tmp_path / "p.ply.blocks/0.rows").write_text("mine")
    for name in ("o.ply", "p.ply"):
        assert svrgs(*whole_and_stopped, "--out", tmp_path / name).status == 0
    assert (tmp_path / "o.ply").read_bytes() != (tmp_path / "whole.ply").read_bytes(), "it was done in memory"
    assert not (tmp_path / "o.ply.blocks").exists()
    assert (tmp_path / "p.ply.blocks/0.rows").read_text() == "mine"


def words_for(tiny, out: Path, *more) -> list:
    words = f"--data {tiny.folder} --method removal --iterations 40 --recovery 20 --block 130".split()
    return ["large", "prune", tiny.splat, *words, "--out", out, *more]


@pytest.fixture
def stopped(svrgs, tiny, tmp_path, monkeypatch) -> Path:
    """The folder of a job of two blocks that was killed while the second one recovered; o.ply would be its
    output."""
    advance = Run.advance

    def kill(run: Run):
        if (
            run.plan.phases[0].active
            or not run.iteration
            or not list(tmp_path.glob("o.ply.blocks/tuned/0.rows"))
        ):
            return advance(run)
        raise RuntimeError("killed")

    with monkeypatch.context() as patch:
        patch.setattr(Run, "advance", kill)
        with pytest.raises(RuntimeError, match="killed"):
            svrgs(*words_for(tiny, tmp_path / "o.ply", "--target", 0.5))
    return tmp_path / "o.ply.blocks"


def test_what_is_done_is_not_done_again(svrgs, tiny, tmp_path, steps, stopped):
    assert progress(stopped) == (6, 7)
    steps.clear()
    assert svrgs(*words_for(tiny, tmp_path / "o.ply", "--target", 0.5, "--resume")).status == 0
    assert steps == list(range(20)) and not stopped.exists()


@pytest.mark.parametrize(
    "change", [["--target", 0.4], ["--target", 0.5, "--lambda-f", 0.5], ["--target", 0.5, "--seed", 3]]
)
def test_another_job_is_not_continued(svrgs, tiny, tmp_path, stopped, change):
    done = svrgs(*words_for(tiny, tmp_path / "o.ply", *change, "--resume"))
    assert done.status == 2 and "is one with other settings or inputs; delete" in done.err
    assert progress(stopped) == (6, 7)


@pytest.mark.slow
def test_without_resume_a_job_starts_again(svrgs, tiny, tmp_path, steps, stopped):
    steps.clear()
    assert svrgs(*words_for(tiny, tmp_path / "o.ply", "--target", 0.4)).status == 0
    assert len(steps) == 2 * (40 + 20) and not stopped.exists()


def test_a_list_of_tasks_that_is_damaged_is_as_none(svrgs, tiny, tmp_path, steps, stopped):
    (stopped / FILE).write_text('{"identity": 3, "total": 7, "done": {}}')
    steps.clear()
    assert svrgs(*words_for(tiny, tmp_path / "o.ply", "--target", 0.5, "--resume")).status == 0
    assert len(steps) == 2 * (40 + 20) and not stopped.exists()


def test_removals_and_merges_have_nothing_to_resume(svrgs, tiny, tmp_path):
    done = svrgs(
        f"large prune {tiny.splat} --data {tiny.folder} --target 0.5 --resume", f"--out {tmp_path}/o.ply"
    )
    assert done.status == 2 and "--resume is for methods that decide on photographs" in done.err


def test_a_stop_before_there_is_anything_to_keep_leaves_nothing(svrgs, short, stop_at, tiny, tmp_path):
    stop_at("score")
    done = svrgs("prune", tiny.splat, "--data", tiny.folder, "--target", 0.5, "--out", tmp_path / "o.ply")
    assert done.status == 130 and not any(tmp_path.iterdir())


def interrupted(tiny, folder: Path) -> JobFolder:
    """The folder of a job of Blender that was stopped while it recovered."""
    job = create(folder, tiny, method="removal", iterations=40, recovery=20, target=0.5)
    with pytest.raises(Cancelled):
        pipeline.prune_scene(
            job.options(),
            lambda context: replace(context, stop=lambda: progress(folder / "recovered.ply.blocks")[0] >= 4),
        )
    return job


def test_a_job_of_blender_says_what_it_goes_on_with_and_can_be_moved(tiny, tmp_path, short, steps):
    folder = interrupted(tiny, tmp_path / "job")
    assert Job(folder).resume_point() == (
        "Resume continues: {done} of {tasks} tasks by blocks are done",
        {"done": 4, "tasks": 5},
    )
    assert (
        folder.size()
        > sum(path.stat().st_size for path in (folder / "recovered.ply.blocks").glob("*"))
        > 50_000
    )
    shutil.move(folder.path, tmp_path / "moved")
    moved = JobFolder(tmp_path / "moved")
    steps.clear()
    result = pipeline.prune_scene(moved.options())
    assert len(steps) <= 20 and result["scene"] == str(tmp_path / "moved" / "scene.ply")
    assert not (moved / "recovered.ply.blocks").exists()


def test_a_job_by_blocks_says_how_much_of_it_is_done(tiny, tmp_path, short):
    job = create(tmp_path / "job", tiny, method="removal", iterations=40, recovery=20, target=0.5)
    told = list[tuple[str, float]]()
    pipeline.prune_scene(
        job.options(), lambda context: replace(context, part=lambda text, share: told.append((text, share)))
    )
    starts = {text.split(":")[0]: share for text, share in reversed(told)}
    assert starts["divide"] == 0 and starts["score"] == 1 / 6 and starts["decide"] == 3 / 6
    assert starts["recover"] == 4 / 6 and starts["measure"] == 5.5 / 6
    shares = [share for _, share in told]
    assert shares == sorted(shares) and len(set(shares)) > 20 and shares[-1] < 1
    ended = Job(job)
    assert not ended.knows_progress and ended.progress == 0
    ended.facts |= {"share": 0.75}
    assert ended.knows_progress and ended.progress == 0.75


def test_a_job_that_is_discarded_takes_its_blocks_along_and_nothing_else(tiny, tmp_path, short):
    folder, elsewhere = interrupted(tiny, tmp_path / "job"), tmp_path / "elsewhere"
    shutil.move(folder / "recovered.ply.blocks" / CUT, elsewhere)
    kept = sorted(elsewhere.iterdir())
    (folder / "recovered.ply.blocks" / CUT).symlink_to(elsewhere)
    with pytest.raises(FormatError, match="is a link"):
        folder.refuse_links()
    folder.discard()
    assert not folder.path.exists() and sorted(elsewhere.iterdir()) == kept


@pytest.mark.slow
def test_a_removal_that_was_killed_leaves_a_folder_of_blocks(stopped, tmp_path, monkeypatch):
    """Whichever file was the last to be removed. So the next job can take the folder."""
    unlink = Path.unlink
    for count in range(1000):
        folder, left = tmp_path / f"copy{count}", [count]
        shutil.copytree(stopped, folder)
        (folder / ".svrgs-0123456789abcdef.rows").touch()  # of a killed writer

        def killed(path: Path, missing_ok: bool = False, left=left):
            left[0] -= path.exists()
            if left[0] < 0:
                raise KeyboardInterrupt
            unlink(path, missing_ok)

        with monkeypatch.context() as patch, contextlib.suppress(KeyboardInterrupt):
            patch.setattr(Path, "unlink", killed)
            remove(folder)
            break
        refuse_foreign(folder)
    assert count > 20 and not folder.exists()
