"""A disk that is too small for the result and a checkpoint is said before the work; what is needed is held
until it is written."""

from __future__ import annotations

import errno
import os
import re
import types
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import whole_jobs
from svrgs_addon.files import disk_space
from svrgs_addon.files.disk_space import CAN_HOLD, HeldSpace, refuse_shortage
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune import loop
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.prune import file_size
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.recipes import fine_tuned
from svrgs_addon.system import memory
from svrgs_addon.system.errors import Cancelled, SceneError
from tiny_jobs import SETTINGS, TRAINING

REFUSED = (
    r"o\.ply: needs [\d.]+ [kM]B of disk space for the result and a checkpoint, but only 10\.0 kB are free in"
    r" .+; free disk space"
)
DESCRIPTORS = Path("/proc/self/fd")


@pytest.fixture
def little(monkeypatch):
    """A disk with 10 kB left."""
    monkeypatch.setattr("shutil.disk_usage", lambda _: types.SimpleNamespace(free=10_000))


def held_in(folder: Path) -> int:
    """Bytes on disk of files without a name that this process has open in the folder."""
    total = 0
    for link in DESCRIPTORS.iterdir():
        if link.is_symlink() and str(folder) in os.readlink(link) and "(deleted)" in os.readlink(link):
            total += 512 * link.stat().st_blocks
    return total


@pytest.mark.parametrize("command", ["prune", "train"])
def test_a_disk_that_is_too_small_is_said_before_the_work(
    svrgs, tiny, tmp_path, little, monkeypatch, command
):
    def work(*_):
        raise AssertionError("the work has begun")

    monkeypatch.setattr(fine_tuned.Tuned, "measured", work)
    monkeypatch.setattr(fine_tuned.Tuned, "tune", work)
    scene = [tiny.splat] if command == "prune" else []
    outcome = svrgs(
        command, *scene, f"--data {tiny.folder} --iterations 2 --recovery 0 --out {tmp_path}/o.ply"
    )
    assert outcome.status == 2 and outcome.err.count("\n") == 1 and re.search(REFUSED, outcome.err), (
        outcome.err
    )
    assert not list(tmp_path.iterdir())


def test_a_background_job_is_refused_before_its_folder_is_made(tiny, tmp_path, little):
    with pytest.raises(
        SceneError, match=r"needs [\d.]+ [kM]B of disk space for the job, but only 10.0 kB are free"
    ):
        JobFolder.create(tmp_path / "jobs/job", read_ply(tiny.splat), {"data": str(tiny.folder)})
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(
    not CAN_HOLD or not DESCRIPTORS.is_dir(),
    reason="this system cannot hold disk space, or does not say what is held",
)
@pytest.mark.parametrize("command", ["prune", "train"])
def test_the_room_is_held_until_it_is_used_and_then_free_again(tiny, data, tmp_path, monkeypatch, command):
    seen, write = [], file_size.write_scene

    def last(path, scene, **choices):
        seen.append(held_in(tmp_path))
        write(path, scene, **choices)

    monkeypatch.setattr(file_size, "write_scene", last)
    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0)
    job = JobContext(tmp_path / "o.ply", observe=lambda _: seen.append(held_in(tmp_path)))
    if command == "prune":
        whole_jobs.prune(tiny.splat, data, SETTINGS, job)
    else:
        whole_jobs.train(data, TRAINING, job)
    *during, at_the_end = seen
    assert min(during) > (tmp_path / "o.ply").stat().st_size and at_the_end == 0
    assert held_in(tmp_path) == 0 and [path.name for path in tmp_path.iterdir()] == ["o.ply"]


@pytest.mark.skipif(not CAN_HOLD, reason="this system cannot hold disk space")
def test_a_disk_that_fills_while_the_room_is_taken_is_one_sentence(tiny, data, tmp_path, monkeypatch):
    def full(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "posix_fallocate", full)
    with pytest.raises(SceneError, match=r"o\.ply: cannot be written \(No space left on device\)"):
        whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(tmp_path / "o.ply"))
    assert not list(tmp_path.iterdir())


@pytest.mark.skipif(not CAN_HOLD, reason="this system cannot hold disk space")
def test_where_space_cannot_be_held_the_work_goes_on(tiny, data, tmp_path, monkeypatch):
    def unknown(*_):
        raise OSError(errno.EOPNOTSUPP, os.strerror(errno.EOPNOTSUPP))

    monkeypatch.setattr(os, "posix_fallocate", unknown)
    HeldSpace(tmp_path, 1000).release()
    whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(tmp_path / "o.ply"))
    assert (tmp_path / "o.ply").exists()


def test_the_size_of_a_checkpoint_is_foreseen(tiny, data, tmp_path):
    with pytest.raises(Cancelled):
        whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(tmp_path / "o.ply", stop=lambda: True))
    (file,) = tmp_path.rglob("arrays.npz")
    with np.load(file) as arrays:
        count, coefficients = arrays["values.sh"].shape[:2]
        size = sum(array.nbytes for array in arrays.values() if len(array) == count)
    foreseen = memory.checkpoint(count, coefficients)
    assert 0.95 * foreseen <= size <= foreseen and file.stat().st_size < foreseen + 10_000


def test_two_folders_on_one_disk_need_the_sum(tmp_path, monkeypatch):
    monkeypatch.setattr(disk_space.shutil, "disk_usage", lambda _: types.SimpleNamespace(free=1_500_000))
    refuse_shortage("o.ply", {tmp_path / "a": 1_000_000}, "the result")
    with pytest.raises(
        SceneError, match="o.ply: needs 2.0 MB of disk space for the result, but only 1.5 MB are free in"
    ):
        refuse_shortage("o.ply", {tmp_path / "a": 1_000_000, tmp_path / "b": 1_000_000}, "the result")
