"""The examples of the Python interface, run as their docstrings say."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from svrgs_addon.files.images import read_image
from svrgs_addon.files.registry import load_scene

ROOT = Path(__file__).resolve().parents[1]


def run(example: str, *words: object) -> str:
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, ROOT / "examples" / example, *map(str, words)],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stderr
    return done.stdout


def test_spatial_mask(tiny, tmp_path):
    colors, mask = tmp_path / "colors.png", tmp_path / "mask.png"
    said = run("spatial_mask.py", tiny.splat, colors, mask)
    assert read_image(colors).shape == read_image(mask).shape == (360, 640, 3)
    assert read_image(colors).max() > 0.5 and read_image(mask).max() > 0.5 and "mean F" in said


def test_rank_and_prune(tiny, tmp_path):
    said = run("rank_and_prune.py", tiny.splat, tiny.folder, tmp_path / "half.ply")
    whole, half = load_scene(tiny.splat), load_scene(tmp_path / "half.ply")
    assert half.count == whole.count // 2
    all_, left = (float(line.partition("PSNR ")[2].split()[0]) for line in said.splitlines())
    assert all_ > 10 and left > 10


@pytest.mark.parametrize("example", sorted(path.name for path in (ROOT / "examples").glob("*.py")))
def test_every_example_is_tested(example):
    assert f"def test_{Path(example).stem}(" in Path(__file__).read_text()
