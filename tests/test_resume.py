"""A stopped job goes on where it was, bit for bit; a checkpoint of another job is refused; a seed gives the
same bytes."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
import tiny_dataset
import whole_jobs
from pictures import photographed
from plans import prune_settings
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.finetune import checkpoint, loop
from svrgs_addon.finetune.checkpoint import read_manifest
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.prune.context import JobContext
from svrgs_addon.system.errors import Cancelled, FormatError, SceneError
from svrgs_addon.system.memory import checkpoint as checkpoint_bytes
from svrgs_addon.views.dataset import load_dataset
from tiny_jobs import SETTINGS, TRAINING, checkpoints, prune


class StopAt:
    """Asks for a stop after some iteration, as Ctrl-C would, and notes which iterations were done."""

    def __init__(self, iteration: int):
        self.iteration, self.seen = iteration, []

    def options(self, out: Path, resume: bool = False) -> JobContext:
        return JobContext(
            out,
            resume=resume,
            observe=lambda p: self.seen.append(p.iteration),
            stop=lambda: self.seen[-1] >= self.iteration,
        )


@pytest.fixture(scope="module")
def whole(tiny, data, tmp_path_factory) -> bytes:
    """The output of the uninterrupted job of SETTINGS."""
    folder = tmp_path_factory.mktemp("whole")
    result = prune(tiny, data, folder / "o.ply")
    assert 5 < read_ply(folder / "o.ply").count < tiny_dataset.COUNT / 2, "pruning events should have bitten"
    assert [path.name for path in folder.iterdir()] == ["o.ply"], "a finished job leaves its output only"
    return result


@pytest.mark.parametrize("iterations", [(1,), (19,), (20,), (60,), (61,), (89,), (5, 20, 21, 59, 70)])
def test_resume_after_stops(tiny, data, whole, tmp_path, iterations):
    out, before = tmp_path / "o.ply", 0
    for iteration in iterations:
        stop = StopAt(iteration)
        with pytest.raises(Cancelled):
            whole_jobs.prune(tiny.splat, data, SETTINGS, stop.options(out, resume=True))
        # resuming must go on where the last run stopped
        assert stop.seen == list(range(before + 1, iteration + 1))
        assert checkpoints(out)[-1] == f"{iteration:07d}" and not out.exists()
        before = iteration
    assert prune(tiny, data, out, resume=True) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["o.ply"]


@pytest.mark.parametrize("iteration", [19, 40, 70, 100, 119, 120, 130])
def test_resume_of_training(data, tmp_path, iteration):
    """Densification statistics, clones and splits, opacity resets, masks."""
    whole_jobs.train(data, TRAINING, JobContext(tmp_path / "whole.ply"), 1)
    assert read_ply(tmp_path / "whole.ply").count != tiny_dataset.SEEN
    with pytest.raises(Cancelled):
        whole_jobs.train(data, TRAINING, StopAt(iteration).options(tmp_path / "o.ply"), 1)
    whole_jobs.train(data, TRAINING, JobContext(tmp_path / "o.ply", resume=True), 1)
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize("iteration", [5, 40, 75])
def test_resume_with_reduced_photographs_and_views_by_loss(data, tmp_path, iteration):
    train, recover = TRAINING.phases
    settings = replace(TRAINING, phases=(replace(train, coarse_until=60), recover), views_by_loss=True)
    whole_jobs.train(data, settings, JobContext(tmp_path / "whole.ply"), 1)
    with pytest.raises(Cancelled):
        whole_jobs.train(data, settings, StopAt(iteration).options(tmp_path / "o.ply"), 1)
    whole_jobs.train(data, settings, JobContext(tmp_path / "o.ply", resume=True), 1)
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize("iteration", [74, 76, 83, 89])
def test_resume_while_values_are_averaged(tiny, data, tmp_path, iteration):
    settings = replace(prune_settings("removal", 30, 60), target=12, seed=5)
    expected = prune(tiny, data, tmp_path / "whole.ply", settings)
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, settings, StopAt(iteration).options(tmp_path / "o.ply"))
    folder = tmp_path / "o.ply.job" / f"{iteration:07d}"
    samples = max(0, iteration - 75)
    assert read_manifest(folder)["averaged"] == samples
    with np.load(folder / "arrays.npz") as arrays:
        size = sum(array.nbytes for name, array in arrays.items() if not name.startswith("views"))
        coefficients = arrays["values.sh"].shape[1]
    # the estimate has room for existence logits
    assert 0.9 <= size / checkpoint_bytes(12, coefficients, 12 if samples else 0) <= 1
    assert prune(tiny, data, tmp_path / "o.ply", settings, resume=True) == expected


def test_a_stop_at_the_last_step_finishes(tiny, data, whole, tmp_path):
    stop = StopAt(SETTINGS.total)
    whole_jobs.prune(tiny.splat, data, SETTINGS, stop.options(tmp_path / "o.ply"))
    assert (tmp_path / "o.ply").read_bytes() == whole


def test_resume_without_a_checkpoint_starts_anew(tiny, data, whole, tmp_path):
    assert prune(tiny, data, tmp_path / "o.ply", resume=True) == whole


def stopped(tiny, data, out: Path, monkeypatch, iteration: int = 45):
    """Leaves checkpoints of the two last iterations."""
    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0)
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, SETTINGS, StopAt(iteration).options(out))
    assert checkpoints(out) == [f"{iteration - 1:07d}", f"{iteration:07d}"]


def damage_truncate(newest: Path):
    data = (newest / "arrays.npz").read_bytes()
    (newest / "arrays.npz").write_bytes(data[: len(data) // 2])


def damage_flip(newest: Path):
    data = bytearray((newest / "arrays.npz").read_bytes())
    data[len(data) // 2] ^= 1
    (newest / "arrays.npz").write_bytes(data)


def damage_no_manifest(newest: Path):
    (newest / "manifest.json").unlink()


def damage_torn_manifest(newest: Path):
    text = (newest / "manifest.json").read_text()
    (newest / "manifest.json").write_text(text[: len(text) // 2])


def damage_empty_manifest(newest: Path):
    (newest / "manifest.json").write_text("{}")


def damage_no_arrays(newest: Path):
    (newest / "arrays.npz").unlink()


DAMAGES = [
    damage_truncate,
    damage_flip,
    damage_no_manifest,
    damage_torn_manifest,
    damage_empty_manifest,
    damage_no_arrays,
]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_torn_checkpoint_falls_back_to_the_one_before(
    tiny, data, whole, tmp_path, monkeypatch, caplog, damage
):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    damage(tmp_path / "o.ply.job" / "0000045")
    stop = StopAt(10**9)
    with caplog.at_level(logging.WARNING):
        whole_jobs.prune(tiny.splat, data, SETTINGS, stop.options(out, resume=True))
    assert stop.seen[0] == 45 and "0000045 is damaged or of another version" in caplog.text
    assert out.read_bytes() == whole and [path.name for path in tmp_path.iterdir()] == ["o.ply"]


def test_a_torn_checkpoint_does_not_displace_later_ones(tiny, data, whole, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    for number in (46, 47):  # as if of a run that had gone further
        shutil.copytree(tmp_path / "o.ply.job/0000045", tmp_path / f"o.ply.job/{number:07d}")
        damage_flip(tmp_path / f"o.ply.job/{number:07d}")
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, SETTINGS, StopAt(46).options(out, resume=True))
    assert checkpoints(out) == ["0000045", "0000046"]
    assert prune(tiny, data, out, resume=True) == whole


def test_without_resume_a_job_starts_anew(tiny, data, whole, tmp_path, monkeypatch):
    """Its checkpoints must not be taken for older than those of the run before it."""
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    stop = StopAt(7)
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, SETTINGS, stop.options(out))
    assert stop.seen == list(range(1, 8)) and checkpoints(out) == ["0000006", "0000007"]
    assert prune(tiny, data, out, resume=True) == whole


OTHER = {
    "seed": replace(SETTINGS, seed=6),
    "lambda": replace(SETTINGS, lambda_f=2e-3),
    "method": replace(prune_settings("svr-a", 60, 30, prune_every=20, lambda_f=1e-3), mask_init=0.5, seed=5),
    "iterations": replace(SETTINGS, phases=(replace(SETTINGS.phases[0], steps=61), SETTINGS.phases[1])),
    "recovery": replace(SETTINGS, phases=(SETTINGS.phases[0], replace(SETTINGS.phases[1], steps=31))),
    "target": replace(SETTINGS, target=40),
    "visible mask": replace(SETTINGS, full=False),
    "background": replace(SETTINGS, background=(0.0, 0.0, 0.5)),
}


def refuse_resume(tiny, data, out: Path, settings=SETTINGS, **options):
    with pytest.raises(
        FormatError,
        match="this checkpoint is of a run with other settings or inputs; delete .*o.ply.job to start again",
    ):
        prune(tiny, data, out, settings, resume=True, **options)


def test_resume_with_other_settings_is_refused(tiny, data, whole, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    for settings in OTHER.values():
        refuse_resume(tiny, data, out, settings)
    refuse_resume(tiny, load_dataset(tiny.folder, holdout=6), out)
    refuse_resume(tiny, data, out, engine="torch")
    other = tmp_path / "photograph"
    photograph = data.photos[0].path.read_bytes()
    # the second has the same size
    for changed in (photograph + b"more", photograph[:-1] + bytes([photograph[-1] ^ 1])):
        other.write_bytes(changed)
        refuse_resume(
            tiny, replace(data, photos=[replace(data.photos[0], path=other), *data.photos[1:]]), out
        )
    other.unlink()
    scene = read_ply(tiny.splat)
    scene.sh[0, 0, 0] += 0.1
    write_ply(tmp_path / "other.ply", scene)
    refuse_resume(replace(tiny, splat=tmp_path / "other.ply"), data, out)
    assert prune(tiny, data, out, resume=True) == whole, "refusing must leave the checkpoints as they are"


def test_seconds_of_a_resumed_job_are_those_of_all_its_parts(tiny, data, tmp_path):
    out, stop = tmp_path / "o.ply", StopAt(60)
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, SETTINGS, stop.options(out))
    result = whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(out, resume=True))
    assert result["seconds"] >= sum(result["seconds_by_phase"].values())


def test_seeds(tiny, data, whole, tmp_path):
    assert prune(tiny, data, tmp_path / "same.ply") == whole
    assert prune(tiny, data, tmp_path / "other.ply", replace(SETTINGS, seed=6)) != whole


def test_a_checkpoint_that_is_there_survives_one_that_cannot_be_written(tmp_path, monkeypatch):
    scene = scenes.random_scene(9)
    run = Run(Model.of(scene), photographed(scene), prune_settings("removal", 4, 4), NativeEngine())
    checkpoint.save(run, tmp_path, "id")

    def full(*_):
        raise SceneError("full")

    monkeypatch.setattr(checkpoint, "write_arrays", full)
    with pytest.raises(SceneError, match="full"):
        checkpoint.save(run, tmp_path, "id")
    assert checkpoint.newest_manifest(tmp_path)["identity"] == "id"


def test_what_a_run_has_counted_goes_on_from_its_checkpoint(tmp_path):
    runs = [
        Run(
            Model.of(scenes.random_scene(count)),
            photographed(scenes.random_scene(9)),
            TRAINING,
            NativeEngine(),
        )
        for count in (9, 5)
    ]
    runs[0].unordered, runs[0].held_back, runs[0].nonfinite, runs[0].target = 3, 2, 1, 7
    checkpoint.save(runs[0], tmp_path, "id")
    assert checkpoint.restore(runs[1], tmp_path, "id")
    counted = ("initial_count", "unordered", "held_back", "nonfinite", "target")
    assert [getattr(runs[1], name) for name in counted] == [9, 3, 2, 1, 7]
