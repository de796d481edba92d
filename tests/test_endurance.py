"""Large scenes and long sessions, in short: the commands of docs/reliability.md run, and fail where they
must."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")
pytest.importorskip("resource", reason="this system does not tell what a process takes")

ROOT = Path(__file__).resolve().parents[1]
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="sizes are read from /proc")


def run(*words: str) -> subprocess.CompletedProcess:
    environment = os.environ | {"PYTHONPATH": f"{ROOT}:{ROOT / 'tests'}"}
    return subprocess.run([sys.executable, *words], cwd=ROOT, env=environment, capture_output=True, text=True)


def test_a_scene_goes_through_every_command():
    done = run("-m", "tests.load", "--count", "3000", "--size", "64", "48", "--steps", "6")
    assert done.returncode == 0 and done.stdout.count(" MB\n") == 6, done.stderr


def test_a_scene_that_takes_more_than_it_may():
    done = run("-m", "tests.load", "--count", "400000", "--size", "64", "48", "--gigabytes", "0.5")
    assert done.returncode == 1 and "MemoryError" in done.stderr and "generate failed" in done.stderr


@pytest.mark.slow
def test_renders_take_no_more_memory():
    done = run("-m", "tests.soak", "--renders", "700")
    assert done.returncode == 0, done.stdout + done.stderr


@pytest.mark.slow
def test_a_leak_is_seen():
    """Of every picture."""
    code = (
        "from tests import soak; kept = []; print(soak.growth(soak.soak(700, lambda image:"
        " kept.append(image.copy()))), soak.LIMIT)"
    )
    grown, limit = map(float, run("-c", code).stdout.split())
    assert grown > limit
