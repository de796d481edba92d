"""Long jobs: stopped or killed they go on where they were, bit for bit; the same request gives the same bytes."""

from __future__ import annotations

import json
import logging
import random
import shutil
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from plans import prune_settings, train_settings
from svrgs_addon.errors import Cancelled, FormatError, SceneError
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import invisible, load_scene
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.jobs import train_and_prune
from svrgs_addon.jobs.stop_request import StopRequest
from svrgs_addon.native import Rasterizer, RenderOptions
from svrgs_addon.photographs.dataset import load_dataset

ROOT = Path(__file__).resolve().parents[1]
# Masks that start undecided, so that pruning events bite within few steps.
SETTINGS = replace(prune_settings("svr", 60, 30, prune_every=20, lambda_f=1e-3), mask_init=0.5, seed=5)
DENSIFY = Densify(start=20, until=100, every=20, reset_every=50, gradient=1e-3)
TRAINING = replace(train_settings("svr", 120, 20, densify=DENSIFY, lambda_f=1e-3), mask_init=1.0)


@pytest.fixture(scope="module")
def data(tiny):
    return load_dataset(tiny.folder)


class StopAt:
    """Asks for a stop after some iteration, as Ctrl-C would, and notes which iterations were done."""

    def __init__(self, iteration: int):
        self.iteration, self.seen = iteration, []

    def options(self, out: Path, resume: bool = False) -> train_and_prune.JobContext:
        return train_and_prune.JobContext(out, resume=resume, observe=lambda p: self.seen.append(p.iteration), stop=lambda: self.seen[-1] >= self.iteration)


def prune(tiny, data, out: Path, settings=SETTINGS, **options) -> bytes:
    train_and_prune.prune(tiny.splat, data, settings, train_and_prune.JobContext(out, **options))
    return out.read_bytes()


@pytest.fixture(scope="module")
def whole(tiny, data, tmp_path_factory) -> bytes:
    """The output of the uninterrupted job of SETTINGS."""
    folder = tmp_path_factory.mktemp("whole")
    result = prune(tiny, data, folder / "o.ply")
    assert 5 < read_ply(folder / "o.ply").count < tiny_dataset.COUNT / 2, "pruning events should have bitten"
    assert [path.name for path in folder.iterdir()] == ["o.ply"], "a finished job leaves its output only"
    return result


def checkpoints(out: Path) -> list[str]:
    return sorted(path.parent.name for path in out.with_name(out.name + ".job").glob("*/manifest.json"))


# --- stop and resume


@pytest.mark.parametrize("iterations", [(1,), (19,), (20,), (60,), (61,), (89,), (5, 20, 21, 59, 70)])
def test_resume_after_stops(tiny, data, whole, tmp_path, iterations):
    out, before = tmp_path / "o.ply", 0
    for iteration in iterations:
        stop = StopAt(iteration)
        with pytest.raises(Cancelled):
            train_and_prune.prune(tiny.splat, data, SETTINGS, stop.options(out, resume=True))
        assert stop.seen == list(range(before + 1, iteration + 1)), "resuming must go on where the last run stopped"
        assert checkpoints(out)[-1] == f"{iteration:07d}" and not out.exists()
        before = iteration
    assert prune(tiny, data, out, resume=True) == whole
    assert [path.name for path in tmp_path.iterdir()] == ["o.ply"]


@pytest.mark.parametrize("iteration", [19, 40, 70, 100, 119, 120, 130])
def test_resume_of_training(data, tmp_path, iteration):
    """Densification statistics, clones and splits, opacity resets, masks."""
    train_and_prune.train(data, TRAINING, train_and_prune.JobContext(tmp_path / "whole.ply"), 1)
    assert read_ply(tmp_path / "whole.ply").count != tiny_dataset.SEEN
    with pytest.raises(Cancelled):
        train_and_prune.train(data, TRAINING, StopAt(iteration).options(tmp_path / "o.ply"), 1)
    train_and_prune.train(data, TRAINING, train_and_prune.JobContext(tmp_path / "o.ply", resume=True), 1)
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


@pytest.mark.parametrize("iteration", [5, 40, 75])
def test_resume_with_reduced_photographs_and_views_by_loss(data, tmp_path, iteration):
    train, recover = TRAINING.phases
    settings = replace(TRAINING, phases=(replace(train, coarse_until=60), recover), views_by_loss=True)
    train_and_prune.train(data, settings, train_and_prune.JobContext(tmp_path / "whole.ply"), 1)
    with pytest.raises(Cancelled):
        train_and_prune.train(data, settings, StopAt(iteration).options(tmp_path / "o.ply"), 1)
    train_and_prune.train(data, settings, train_and_prune.JobContext(tmp_path / "o.ply", resume=True), 1)
    assert (tmp_path / "o.ply").read_bytes() == (tmp_path / "whole.ply").read_bytes()


def test_the_command_line_reaches_the_skips(tiny, svrgs, tmp_path):
    words = ("train", "--colmap", tiny.folder, "--iterations", 30, "--sh-degree", 0, "--quiet", "--json", "--out")
    outs = []
    for k, more in enumerate([(), ("--coarse-until", 0), ("--coarse-until", 15), ("--views-by-loss",)]):
        assert svrgs(*words, tmp_path / f"{k}.ply", *more).status == 0
        outs.append((tmp_path / f"{k}.ply").read_bytes())
    assert outs[0] == outs[1] and len(set(outs)) == 3


def test_a_job_leaves_its_dataset_as_it_was(data, tmp_path):
    points, colors = data.points.copy(), data.point_colors.copy()
    train_and_prune.train(data, TRAINING, train_and_prune.JobContext(tmp_path / "o.ply"), 1)
    assert (data.points == points).all() and (data.point_colors == colors).all()


def test_a_pruned_file_keeps_the_order_of_its_source(tiny, data, tmp_path):
    """Though rows were in another order while the job worked; further columns still belong to their Gaussians."""
    source = read_ply(tiny.splat)
    labels = np.arange(source.count, dtype=np.float32)
    write_ply(tmp_path / "labelled.ply", replace(source, attributes={"label": labels}, property_order=()))
    prune(replace(tiny, splat=tmp_path / "labelled.ply"), data, tmp_path / "o.ply")
    left = read_ply(tmp_path / "o.ply")
    rows = left.attributes["label"].astype(int)
    assert 5 < left.count < source.count and (np.diff(rows) > 0).all()
    moved = np.linalg.norm(left.means - source.means[rows], axis=1)
    assert moved.max() < 0.05 < np.median(np.linalg.norm(source.means - source.means.mean(axis=0), axis=1))


@pytest.mark.parametrize(
    ("method", "min_contribution", "target"),
    [("pressure", 0.0, 0), ("pressure", 0.2, 0), ("pressure", 0.9, 150), ("pressure", 0.9, 230), ("contribution", 0.1, 40)],
)
def test_the_first_cut_is_that_of_one_look_after_the_other(tiny, data, method, min_contribution, target):
    """Faint ones are no part of what is looked at, though all of a scene is drawn once: not even in place of those that no view shows."""
    scene = load_scene(tiny.splat).scene
    scene = scene.select(np.arange(scene.count)[::-1])  # the faint ones first
    scene.means[100:120, 1] += 1e4  # out of every view
    settings = prune_settings(method, 0 if method == "contribution" else 10, 0, target=target, min_contribution=min_contribution)
    views = [data.cameras[i] for i in data.train_indices]
    left = scene.select(~invisible(scene))
    for limit, count in ((min_contribution, target), (np.inf, target if method == "contribution" else left.count)):
        score, peaks, _ = scores.contribution(left, views, Rasterizer(), RenderOptions())
        left = left.select((peaks >= limit) | scores.top(peaks if np.isfinite(limit) else score, count))
    cut = train_and_prune.first_cut(scene, data, settings)
    assert 0 < cut.count < scene.count
    np.testing.assert_array_equal(cut.means, left.means)


def test_a_stop_at_the_last_step_finishes(tiny, data, whole, tmp_path):
    stop = StopAt(SETTINGS.total)
    train_and_prune.prune(tiny.splat, data, SETTINGS, stop.options(tmp_path / "o.ply"))
    assert (tmp_path / "o.ply").read_bytes() == whole


def test_resume_without_a_checkpoint_starts_anew(tiny, data, whole, tmp_path):
    assert prune(tiny, data, tmp_path / "o.ply", resume=True) == whole


def stopped(tiny, data, out: Path, monkeypatch, iteration: int = 45):
    """Leaves checkpoints of the two last iterations."""
    monkeypatch.setattr(train_and_prune, "CHECKPOINT_SECONDS", 0)
    with pytest.raises(Cancelled):
        train_and_prune.prune(tiny.splat, data, SETTINGS, StopAt(iteration).options(out))
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


DAMAGES = [damage_truncate, damage_flip, damage_no_manifest, damage_torn_manifest, damage_empty_manifest, damage_no_arrays]


@pytest.mark.parametrize("damage", DAMAGES, ids=lambda damage: damage.__name__)
def test_a_torn_checkpoint_falls_back_to_the_one_before(tiny, data, whole, tmp_path, monkeypatch, caplog, damage):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    damage(tmp_path / "o.ply.job" / "0000045")
    stop = StopAt(10**9)
    with caplog.at_level(logging.WARNING):
        train_and_prune.prune(tiny.splat, data, SETTINGS, stop.options(out, resume=True))
    assert stop.seen[0] == 45 and "0000045 is damaged or of another version" in caplog.text
    assert out.read_bytes() == whole and [path.name for path in tmp_path.iterdir()] == ["o.ply"]


def test_a_torn_checkpoint_does_not_displace_later_ones(tiny, data, whole, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    for number in (46, 47):  # as if of a run that had gone further
        shutil.copytree(tmp_path / "o.ply.job/0000045", tmp_path / f"o.ply.job/{number:07d}")
        damage_flip(tmp_path / f"o.ply.job/{number:07d}")
    with pytest.raises(Cancelled):
        train_and_prune.prune(tiny.splat, data, SETTINGS, StopAt(46).options(out, resume=True))
    assert checkpoints(out) == ["0000045", "0000046"]
    assert prune(tiny, data, out, resume=True) == whole


def test_without_resume_a_job_starts_anew(tiny, data, whole, tmp_path, monkeypatch):
    """Its checkpoints must not be taken for older than those of the run before it."""
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    stop = StopAt(7)
    with pytest.raises(Cancelled):
        train_and_prune.prune(tiny.splat, data, SETTINGS, stop.options(out))
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
    with pytest.raises(FormatError, match="this checkpoint is of a run with other settings or inputs; delete .*o.ply.job to start again"):
        prune(tiny, data, out, settings, resume=True, **options)


def test_resume_with_other_settings_is_refused(tiny, data, whole, tmp_path, monkeypatch):
    out = tmp_path / "o.ply"
    stopped(tiny, data, out, monkeypatch)
    for settings in OTHER.values():
        refuse_resume(tiny, data, out, settings)
    refuse_resume(tiny, load_dataset(tiny.folder, holdout=6), out)
    refuse_resume(tiny, data, out, engine="torch")
    other = tmp_path / "photograph"
    other.write_bytes(data.photos[0].path.read_bytes() + b"more")
    refuse_resume(tiny, replace(data, photos=[replace(data.photos[0], path=other), *data.photos[1:]]), out)
    other.unlink()
    scene = read_ply(tiny.splat)
    scene.sh[0, 0, 0] += 0.1
    write_ply(tmp_path / "other.ply", scene)
    refuse_resume(replace(tiny, splat=tmp_path / "other.ply"), data, out)
    assert prune(tiny, data, out, resume=True) == whole, "refusing must leave the checkpoints as they are"


# --- determinism


def test_threads_do_not_change_the_output(tiny, svrgs, tmp_path):
    words = ("prune", tiny.splat, "--colmap", tiny.folder, "--iterations", 60, "--recovery", 20, "--target", 0.5, "--quiet")
    for threads in (1, 2):
        assert svrgs(*words, "--threads", threads, "--out", tmp_path / f"{threads}.ply").status == 0
    assert svrgs(*words, "--threads", 1, "--seed", 1, "--out", tmp_path / "seed.ply").status == 0
    one, two, seed = ((tmp_path / f"{name}.ply").read_bytes() for name in (1, 2, "seed"))
    assert one == two != seed


def test_threads_do_not_change_training(tiny, svrgs, tmp_path):
    words = ("train", "--colmap", tiny.folder, "--iterations", 620, "--densify-until", 650, "--sh-degree", 1, "--quiet", "--json")
    counts = [svrgs(*words, "--threads", threads, "--out", tmp_path / f"{threads}.ply").json["count"] for threads in (1, 2)]
    assert counts[0] == counts[1] != tiny_dataset.SEEN, "densification should have happened"
    assert (tmp_path / "1.ply").read_bytes() == (tmp_path / "2.ply").read_bytes()


def test_seeds(tiny, data, whole, tmp_path):
    assert prune(tiny, data, tmp_path / "same.ply") == whole
    assert prune(tiny, data, tmp_path / "other.ply", replace(SETTINGS, seed=6)) != whole


# --- signals and kills, in processes of their own


ENDLESS = 3000
RUN = "import sys, time\nfrom svrgs_addon.cli.main import main\nfrom svrgs_addon.jobs import train_and_prune\n{change}\nsys.exit(main(sys.argv[1:]))"
FREQUENT = RUN.format(change="train_and_prune.CHECKPOINT_SECONDS = 0")


def words_for(tiny, out: Path, iterations: int, recovery: int) -> list[str]:
    words = ["prune", tiny.splat, "--colmap", tiny.folder, "--iterations", iterations, "--recovery", recovery, "--target", 0.5, "--resume", "--out", out]
    return [str(word) for word in words]


def start(*command: str) -> subprocess.Popen:
    return subprocess.Popen([sys.executable, *command], cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def run(*command: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, *command], cwd=ROOT, capture_output=True, text=True)


def wait_until(condition, process: subprocess.Popen, seconds: float = 30):
    deadline = time.monotonic() + seconds
    while not condition():
        assert process.poll() is None, process.communicate()[1]
        assert time.monotonic() < deadline, "nothing happened"
        time.sleep(0.002)


@pytest.fixture(scope="module")
def whole_command(tiny, tmp_path_factory) -> bytes:
    out = tmp_path_factory.mktemp("whole") / "o.ply"
    done = run("-m", "svrgs_addon", *words_for(tiny, out, 120, 120))
    assert done.returncode == 0, done.stderr
    return out.read_bytes()


def test_kill_and_resume(tiny, whole_command, tmp_path):
    """kill -9 at random moments, among them within the writing of a checkpoint, in both phases."""
    out, chance = tmp_path / "o.ply", random.Random(8)
    for goal in (10, 60, 110, 150):
        process = start("-c", FREQUENT, *words_for(tiny, out, 120, 120))
        wait_until(lambda: (checkpoints(out) or ["0"])[-1] >= f"{goal:07d}", process)  # noqa: B023
        time.sleep(chance.random() * 0.02)
        process.kill()
        process.communicate()
        assert process.returncode == -signal.SIGKILL and not out.exists()
    reached = int(checkpoints(out)[-1])
    done = run("-m", "svrgs_addon", *words_for(tiny, out, 120, 120))
    assert done.returncode == 0 and f"recover {reached + 1}/240" in done.stderr, done.stderr
    assert out.read_bytes() == whole_command and [path.name for path in tmp_path.iterdir()] == ["o.ply"]


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_stop_signals_finish_the_step(tiny, tmp_path, number):
    out = tmp_path / "o.ply"
    process = start("-m", "svrgs_addon", *words_for(tiny, out, ENDLESS, 60))
    assert "press 1/" in process.stderr.readline()
    process.send_signal(number)
    output, errors = process.communicate(timeout=30)
    assert (process.returncode, output) == (130, "") and not out.exists()
    lines = [line for line in errors.splitlines() if line]
    assert [line.split(";")[0] for line in lines] == ["stopping after this step", "svrgs: stopped"], errors
    (checkpoint,) = checkpoints(out)
    manifest = json.loads((tmp_path / "o.ply.job" / checkpoint / "manifest.json").read_text())
    assert manifest["iteration"] == int(checkpoint) < ENDLESS


def test_ctrl_c_then_resume_is_bit_identical(tiny, whole_command, tmp_path):
    """A run slowed down by a checkpoint a step, so that Ctrl-C comes in the middle of it."""
    out = tmp_path / "o.ply"
    process = start("-c", FREQUENT, *words_for(tiny, out, 120, 120))
    wait_until(lambda: len(checkpoints(out)) > 1, process)
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=30)
    assert process.returncode == 130 and "Traceback" not in errors and not out.exists(), errors
    done = run("-m", "svrgs_addon", *words_for(tiny, out, 120, 120))
    assert done.returncode == 0 and out.read_bytes() == whole_command, done.stderr


def test_a_stop_request_hears_both_signals():
    """A batch passes Ctrl-C on as SIGTERM beside the terminal's own: in either order the two are one request."""
    told, before = [], [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)]
    for order in ((signal.SIGTERM, signal.SIGINT), (signal.SIGINT, signal.SIGTERM)):
        with StopRequest(lambda: told.append("asked")) as stop:
            assert not stop()
            for number in order:
                signal.raise_signal(number)
                assert stop()
            with pytest.raises(KeyboardInterrupt):
                signal.raise_signal(signal.SIGINT)
        assert [signal.getsignal(number) for number in (signal.SIGINT, signal.SIGTERM)] == before
    assert told == ["asked"] * 2


def test_a_second_ctrl_c_ends_at_once(tiny, tmp_path):
    busy = "lambda *_: (print('ready', file=sys.stderr, flush=True), time.sleep(60))"
    code = RUN.format(change=f"train_and_prune.fine_tune = {busy}")
    process = start("-c", code, *words_for(tiny, tmp_path / "o.ply", 10, 0))
    assert process.stderr.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    assert process.stderr.readline() == "\n" and "stopping after this step" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 130 and errors == "svrgs: interrupted\n"


def test_sigterm_while_nothing_can_be_kept_ends_without_a_stack_trace():
    code = "import os, signal\nfrom svrgs_addon.photographs.colmap import import_pycolmap\nimport_pycolmap()\nos.kill(os.getpid(), signal.SIGTERM)"
    done = run("-c", code)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")


# --- what is refused, nothing written


def test_a_target_may_be_as_small_as_is_asked_for(tiny, data, tmp_path):
    scene = read_ply(tiny.splat)
    write_ply(tmp_path / "big.ply", scene.select(np.repeat(np.arange(scene.count), 10)))
    for method in ("svr", "pressure", "opacity"):
        prune(replace(tiny, splat=tmp_path / "big.ply"), data, tmp_path / "o.ply", prune_settings(method, 30, 2, target=2))
        assert read_ply(tmp_path / "o.ply").count == 2


def test_a_target_needs_iterations_to_prune_in(data, tmp_path):
    for method in ("maskgs", "opacity", "saliency"):
        with pytest.raises(SceneError, match=f"method '{method}' cannot reach a target without iterations in which it prunes"):
            train_and_prune.train(data, train_settings(method, 0, 5, target=20), train_and_prune.JobContext(tmp_path / "o.ply"))


def test_lambda_is_told_where_it_decided(tiny, data, tmp_path):
    def told(**settings):
        options = train_and_prune.JobContext(tmp_path / "o.ply")
        return train_and_prune.prune(tiny.splat, data, prune_settings(settings.pop("method"), 20, 0, lambda_f=1e-5, **settings), options)["lambda_f"]

    assert told(method="pressure") == told(method="svr", target=100) == told(method="saliency") == 1e-5
    assert told(method="pressure", target=100) is told(method="saliency", max_drop=3.0) is None


def test_seconds_of_a_resumed_job_are_those_of_all_its_parts(tiny, data, tmp_path):
    out, stop = tmp_path / "o.ply", StopAt(60)
    with pytest.raises(Cancelled):
        train_and_prune.prune(tiny.splat, data, SETTINGS, stop.options(out))
    result = train_and_prune.prune(tiny.splat, data, SETTINGS, train_and_prune.JobContext(out, resume=True))
    assert result["seconds"] >= sum(result["seconds_by_phase"].values())


def test_a_scene_that_would_lose_everything(tiny, data, tmp_path):
    settings = replace(SETTINGS, mask_init=-20.0)
    with pytest.raises(SceneError, match="pruning would leave 0 of 240 Gaussians"):
        prune(tiny, data, tmp_path / "o.ply", settings)
    assert not list(tmp_path.iterdir())
