"""Signals and kills: a job in a process of its own stops after its step, or goes on from its last
checkpoint."""

from __future__ import annotations

import json
import random
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from svrgs_addon.prune.stop_request import StopRequest
from tiny_jobs import checkpoints

ROOT = Path(__file__).resolve().parents[1]


ENDLESS = 3000
RUN = """
import sys, time
from svrgs_addon.cli.main import main
from svrgs_addon.finetune import loop
from svrgs_addon.prune.recipes import fine_tuned
{change}
sys.exit(main(sys.argv[1:]))
"""
FREQUENT = RUN.format(change="loop.CHECKPOINT_SECONDS = 0")


def words_for(tiny, out: Path, iterations: int, recovery: int) -> list[str]:
    return (
        f"prune {tiny.splat} --data {tiny.folder} --iterations {iterations} --recovery {recovery}"
        f" --target 0.5 --resume --out {out}"
    ).split()


def heard():
    """The stop signals as a terminal sets them: nohup and a shell's & let their children ignore some."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_DFL)


def start(*command: str) -> subprocess.Popen:
    return subprocess.Popen(
        [sys.executable, *command],
        cwd=ROOT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        preexec_fn=heard,
    )


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


@pytest.mark.slow
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


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
def test_stop_signals_finish_the_step(tiny, tmp_path, number):
    out = tmp_path / "o.ply"
    process = start("-m", "svrgs_addon", *words_for(tiny, out, ENDLESS, 60))
    assert "prune 1/" in process.stderr.readline()
    process.send_signal(number)
    output, errors = process.communicate(timeout=30)
    assert (process.returncode, output) == (130, "") and not out.exists()
    lines = [line for line in errors.splitlines() if line]
    assert [line.split(";")[0] for line in lines] == ["stopping after this step", "svrgs: stopped"], errors
    (checkpoint,) = checkpoints(out)
    manifest = json.loads((tmp_path / "o.ply.job" / checkpoint / "manifest.json").read_text())
    assert manifest["iteration"] == int(checkpoint) < ENDLESS


@pytest.mark.slow
def test_a_job_under_nohup_outlives_its_terminal(tiny, tmp_path):
    process = start(
        "-c",
        RUN.format(change="import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)"),
        *words_for(tiny, tmp_path / "o.ply", 2000, 0),
    )
    assert "prune 1/" in process.stderr.readline()
    process.send_signal(signal.SIGHUP)
    process.communicate(timeout=120)
    assert process.returncode == 0 and (tmp_path / "o.ply").exists()


@pytest.mark.slow
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
    """A batch passes Ctrl-C on as SIGTERM beside the terminal's own: in either order the two are one
    request."""
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
    code = RUN.format(change=f"fine_tuned.FineTuned.tune = {busy}")
    process = start("-c", code, *words_for(tiny, tmp_path / "o.ply", 10, 0))
    assert process.stderr.readline() == "ready\n"
    process.send_signal(signal.SIGINT)
    assert process.stderr.readline() == "\n" and "stopping after this step" in process.stderr.readline()
    process.send_signal(signal.SIGINT)
    _, errors = process.communicate(timeout=10)
    assert process.returncode == 130 and errors == "svrgs: interrupted\n"


def test_sigterm_while_nothing_can_be_kept_ends_without_a_stack_trace():
    code = (
        "import os, signal\nfrom svrgs_addon.views.colmap import"
        " import_pycolmap\nimport_pycolmap()\nos.kill(os.getpid(), signal.SIGTERM)"
    )
    done = run("-c", code)
    assert (done.returncode, done.stderr) == (-signal.SIGTERM, "")
