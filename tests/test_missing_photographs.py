"""A dataset that lacks some photographs is used as far as it goes, and every command says what is missing."""

from __future__ import annotations

import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
import whole_jobs
from job_checks import ROOT, SHORT, create, follow
from svrgs_addon.jobs.estimate import estimate
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.system.errors import Cancelled, FormatError
from svrgs_addon.views.dataset import load_dataset
from tiny_jobs import SETTINGS, checkpoints, prune

MISSING = ("01.png", "05.png", "08.png")  # the last is a test view
SENTENCE = "3 of 12 photographs are missing: 01.png, 05.png, 08.png; the other 9 are used"


@pytest.fixture
def fewer(tiny, tmp_path) -> tiny_dataset.Tiny:
    """The tiny dataset without MISSING."""
    folder = tmp_path / "fewer"
    shutil.copytree(tiny.folder, folder)
    for name in MISSING:
        (folder / "images" / name).unlink()
    return tiny_dataset.Tiny(folder, folder / "scene.ply", tiny.truth, tiny.cameras)


COMMANDS = {
    "prune": (
        "prune {scene} --data {data} --method opacity --target 0.5 --recovery 5 --quiet --out {out}/o.ply"
        " --report {out}"
    ),
    "train": "train --data {data} --iterations 5 --quiet --out {out}/o.ply",
    "eval": "eval {scene} --data {data}",
    "compare": "compare {scene} {scene} --data {data} --out {out}",
}


@pytest.mark.parametrize("name", COMMANDS)
def test_commands_go_on_and_say_what_is_missing(fewer, svrgs, tmp_path, caplog, name):
    out = tmp_path / "out"
    out.mkdir()
    done = svrgs(*COMMANDS[name].format(scene=fewer.splat, data=fewer.folder, out=out).split(), "--json")
    note = f"{fewer.folder}/images: {SENTENCE}"
    assert done.json["notes"] == [note]
    assert caplog.messages == [note], "which the terminal shows, see below"
    pages = [path.read_text() for path in out.glob("index.html")]
    assert len(pages) == (name in ("prune", "compare")) and all(SENTENCE in page for page in pages)


def test_the_terminal_shows_it(fewer):
    words = [sys.executable, "-m", "svrgs_addon", "eval", fewer.splat, "--data", fewer.folder]
    done = subprocess.run(list(map(str, words)), cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0 and f"svrgs: {fewer.folder}/images: {SENTENCE}\n" in done.stderr


def test_an_estimate_names_them_too(fewer):
    assert (
        SENTENCE
        in estimate(PruneOptions(scene=fewer.splat, data=fewer.folder, iterations=50)).get("notes")[0]
    )


def test_a_background_job_says_it_while_it_runs(fewer, tmp_path, jobs):
    job = Job(create(tmp_path / "job", fewer, **SHORT))
    jobs.append(job)
    job.start()
    follow(job)
    assert job.state == "done" and SENTENCE in job.facts["note"] and SENTENCE in job.folder.state()["note"]
    assert SENTENCE in job.folder.result()["notes"][0]


def test_resume_needs_the_same_photographs(fewer, tmp_path):
    out, data, steps = tmp_path / "o.ply", load_dataset(fewer.folder), []
    context = JobContext(out, observe=lambda p: steps.append(p.iteration), stop=lambda: len(steps) == 30)
    with pytest.raises(Cancelled):
        whole_jobs.prune(fewer.splat, data, SETTINGS, context)
    moved = fewer.folder / "images/02.png"
    kept = moved.read_bytes()
    moved.unlink()
    with pytest.raises(FormatError, match="other settings or inputs"):
        prune(fewer, load_dataset(fewer.folder), out, resume=True)
    moved.write_bytes(kept)
    assert checkpoints(out)
    resumed = prune(fewer, load_dataset(fewer.folder), out, resume=True)
    assert resumed == prune(fewer, data, tmp_path / "whole.ply")


def test_a_damaged_photograph_is_refused_and_named(fewer, svrgs):
    photo: Path = fewer.folder / "images/03.png"
    photo.write_bytes(photo.read_bytes()[:-200])
    done = svrgs(
        "train", "--data", fewer.folder, "--iterations", 20, "--quiet", "--out", fewer.folder / "o.ply"
    )
    assert done.status == 2 and f"{photo}: cannot be read as an image" in done.err
