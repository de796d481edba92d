"""Killed, out of space, not permitted, inputs gone: the old file or the new one is whole, one sentence says
why, work is kept."""

from __future__ import annotations

import errno
import os
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")
pytest.importorskip("resource", reason="this system cannot limit the size of files")

import resource

import whole_jobs
from faults import WRITERS, digest
from faults.jobs import JOBS
from plans import prune_settings
from svrgs_addon.files.ply import read_ply
from svrgs_addon.finetune import checkpoint, loop
from svrgs_addon.prune import file_size
from svrgs_addon.prune.context import JobContext
from svrgs_addon.system.errors import SceneError, SplatError
from svrgs_addon.views.dataset import load_dataset

ROOT = Path(__file__).resolve().parents[1]
SETTINGS = replace(prune_settings("svr", 30, 10, prune_every=15, lambda_f=1e-3), mask_init=0.5, seed=5)


# --- killed


SHORT = "scene.ply"  # the one that `make test` kills
LONG = [name for name in (*JOBS, *WRITERS) if name != SHORT]


def faults(folder: Path, *words: str) -> str:
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}", "TMPDIR": str(folder)}
    command = [sys.executable, "-m", "tests.faults", "--seed", "3", *words]
    done = subprocess.run(command, cwd=ROOT, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    return done.stdout


@pytest.mark.parametrize("target", [SHORT, *(pytest.param(name, marks=pytest.mark.slow) for name in LONG)])
def test_killed_at_random_moments(target, tmp_path):
    """A few here; `python -m tests.faults` for 200 each."""
    assert "3 kills survived" in faults(tmp_path, "--kills", "3", target)


@pytest.mark.slow
def test_a_disk_that_is_full_from_a_write_on(tmp_path):
    """A few here; `python -m tests.faults --disk 0` for every write of every recipe."""
    assert "a full disk at 3 writes survived" in faults(tmp_path, "--disk", "3", "quick")


# --- writers that cannot


@pytest.fixture
def old(tmp_path):
    """A file of each writer as it was: name -> path."""
    for name, write in WRITERS.items():
        write(tmp_path / name, 0)
    return tmp_path


def refused(folder: Path, name: str, reason: str):
    """One sentence that names the file, and the folder as it was."""
    before = {path.name: digest(path) for path in folder.iterdir()}
    with pytest.raises(SplatError, match=reason) as caught:
        WRITERS[name](folder / name, 1)
    assert name in str(caught.value) and "\n" not in str(caught.value)
    assert {path.name: digest(path) for path in folder.iterdir()} == before


def failing(number: int):
    def fail(*_, **__):
        raise OSError(number, os.strerror(number))

    return fail


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("number", [errno.ENOSPC, errno.EIO])
@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_errors_of_the_disk_while_storing(old, monkeypatch, name, number, call):
    monkeypatch.setattr(os, call, failing(number))
    refused(old, name, os.strerror(number))


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("number", [errno.EACCES, errno.EROFS, errno.EPERM])
def test_folders_that_allow_no_writing(old, monkeypatch, name, number):
    monkeypatch.setattr(os, "open", failing(number))
    refused(old, name, os.strerror(number))


@pytest.mark.parametrize("name", WRITERS)
@pytest.mark.parametrize("share", [0.0, 0.001, 0.3, 0.9, 0.9999])
def test_space_that_ends_within_the_file(old, name, share):
    """The system lets files grow to part of this one's size: a write fails half way, as on a full disk."""
    WRITERS[name](old / name, 1)
    size = (old / name).stat().st_size
    WRITERS[name](old / name, 0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (int(share * size), hard))
    try:
        refused(old, name, "cannot be written")
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def test_too_little_space_is_known_before(old, monkeypatch):
    usage = type("Usage", (), {"free": 1000})
    monkeypatch.setattr("shutil.disk_usage", lambda _: usage)
    refused(old, "scene.ply", r"needs 2.3 MB, but only 1.0 kB are free")


# --- runs that cannot go on


@pytest.fixture
def data(tiny, tmp_path):
    """The dataset in a folder of its own, read anew from it for each view."""
    import shutil

    shutil.copytree(tiny.folder, tmp_path / "data")
    return load_dataset(tmp_path / "data", memory_budget=0)


def at(iteration: int, action):
    return lambda progress: action() if progress.iteration == iteration else None


@pytest.mark.parametrize(
    "damage",
    [
        Path.unlink,
        lambda path: path.write_bytes(b"gone"),
        lambda path: path.write_bytes(path.read_bytes()[:90]),
    ],
)
def test_photographs_that_vanish_lose_no_work(tiny, data, tmp_path, damage):
    """A checkpoint of the last whole step is left, and with the photographs back the run ends as if nothing
    had been."""
    whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(tmp_path / "whole.ply"))
    photos = sorted((tmp_path / "data/images").iterdir())
    kept = {photo: photo.read_bytes() for photo in photos}

    def lose():
        for photo in photos:
            damage(photo)

    out = tmp_path / "o.ply"
    with pytest.raises(SplatError, match=r"images/\d+\.png") as caught:
        whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(out, observe=at(12, lose)))
    assert "\n" not in str(caught.value) and not out.exists()
    (left,) = (tmp_path / "o.ply.job").iterdir()
    assert checkpoint.read_manifest(left)["iteration"] >= 12
    for photo, content in kept.items():
        photo.write_bytes(content)
    whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(out, resume=True))
    assert out.read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_a_full_disk_at_the_end_leaves_the_last_checkpoint(tiny, data, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)

    def write(path, scene, **choices):
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, hard))
        try:
            original(path, scene, **choices)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))

    original = file_size.write_scene
    monkeypatch.setattr(file_size, "write_scene", write)
    with pytest.raises(SceneError, match="cannot be written"):
        whole_jobs.prune(tiny.splat, data, SETTINGS, JobContext(out))
    assert not out.exists()
    monkeypatch.setattr(file_size, "write_scene", original)
    seen = []
    whole_jobs.prune(
        tiny.splat, data, SETTINGS, JobContext(out, resume=True, observe=lambda p: seen.append(p.iteration))
    )
    assert len(seen) <= 1 and read_ply(out).count > 5


def test_a_checkpoint_that_cannot_be_written_leaves_the_one_before(tiny, data, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    monkeypatch.setattr(loop, "CHECKPOINT_SECONDS", 0)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    try:
        with pytest.raises(SceneError, match="arrays.npz: cannot be written"):
            whole_jobs.prune(
                tiny.splat,
                data,
                SETTINGS,
                JobContext(
                    out, observe=at(8, lambda: resource.setrlimit(resource.RLIMIT_FSIZE, (1000, hard)))
                ),
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    left = sorted((tmp_path / "o.ply.job").rglob("*.*"))
    assert [str(path.relative_to(tmp_path / "o.ply.job")) for path in left] == [
        f"{folder}/{name}" for folder in ("0000006", "0000007") for name in ("arrays.npz", "manifest.json")
    ]
    assert all(checkpoint.read_manifest(folder) for folder in {path.parent for path in left})


FULL_DISK = """
import resource, sys
from svrgs_addon.cli.main import main
from svrgs_addon.finetune import loop
loop.CHECKPOINT_SECONDS = 0
resource.setrlimit(resource.RLIMIT_FSIZE, (int(sys.argv.pop(1)),) * 2)
sys.exit(main(sys.argv[1:]))
"""


@pytest.mark.parametrize(
    "size",
    [pytest.param(15_000, marks=pytest.mark.slow), 20_000, pytest.param(40_000, marks=pytest.mark.slow)],
)
def test_a_first_checkpoint_that_cannot_be_written_is_one_sentence(tiny, tmp_path, size):
    """Nothing else on the terminal, and no file or folder of it."""
    words = (
        f"prune {tiny.splat} --data {tiny.folder} --iterations 4 --recovery 0 --quiet --out {tmp_path}/o.ply"
    ).split()
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, str(size), *words], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert done.stderr.startswith("svrgs: ") and "cannot be written (File too large)" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_copy_of_a_model_that_cannot_be_written_is_one_sentence(tiny, tmp_path):
    words = ["prune", tiny.splat, "--data", tiny.folder, "--quiet", "--out", tmp_path / "o.ply"]
    done = subprocess.run(
        [sys.executable, "-c", FULL_DISK, "3000", *words], cwd=ROOT, capture_output=True, text=True
    )
    assert (done.returncode, done.stdout, done.stderr.count("\n")) == (2, "", 1), done.stderr
    assert "points3D.bin: this temporary file cannot be written (File too large)" in done.stderr
    assert not list(tmp_path.iterdir())


def test_a_splat_that_vanishes(svrgs, tiny, tmp_path):
    gone = tmp_path / "gone.ply"
    for command in (
        ["info", gone],
        ["prune", gone, "--data", tiny.folder, "--out", tmp_path / "o.ply"],
        ["eval", gone, "--data", tiny.folder],
    ):
        outcome = svrgs(*command)
        assert outcome.status == 2 and outcome.err.count("\n") == 1 and "gone.ply" in outcome.err


def test_a_file_that_shrinks_while_it_is_read(tmp_path, monkeypatch):
    from svrgs_addon.files import ply_body

    WRITERS["scene.ply"](tmp_path / "a.ply", 1)
    original = ply_body.Body._convert

    def cut(self, *given):
        os.truncate(tmp_path / "a.ply", 3000)
        return original(self, *given)

    monkeypatch.setattr(ply_body.Body, "_convert", cut)
    with pytest.raises(SplatError, match="became shorter"):
        read_ply(tmp_path / "a.ply")
    assert np.isfinite(os.stat(tmp_path / "a.ply").st_size)
