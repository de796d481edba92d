"""The scripts in benchmarks/, which no other test runs, can be started."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
FILES = sorted((ROOT / "benchmarks").glob("*.py"))
IMPORT = (
    "import importlib, sys; sys.path[:0] = sys.argv[1:3]; [importlib.import_module(n) for n in sys.argv[3:]]"
)


def test_every_file_is_imported():
    pytest.importorskip("torch")  # of texture.py
    names = [file.stem for file in FILES]
    words = [sys.executable, "-c", IMPORT, str(ROOT), str(ROOT / "benchmarks"), *names]
    done = subprocess.run(words, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


def test_the_page_on_forecasts_is_that_of_its_rows(tmp_path):
    words = [sys.executable, str(ROOT / "benchmarks/forecast.py"), "--show", str(tmp_path / "forecast.md")]
    done = subprocess.run(words, capture_output=True, text=True, cwd=ROOT)
    assert done.returncode == 0, done.stderr
    assert (tmp_path / "forecast.md").read_text() == (ROOT / "docs/forecast.md").read_text()
