"""The scripts of tools/, the Makefile that calls them, and what stays out of the extension."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest

import fetch_wheels
import platforms

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ROOT / "tools"


def find_python(*versions: str) -> str:
    return subprocess.run(
        [TOOLS / "find_python.sh", *versions], capture_output=True, text=True, check=True
    ).stdout.strip()


def test_find_python_takes_the_first_that_runs():
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = find_python("9.99", version)
    if not found:
        pytest.skip(f"no python{version} on PATH")
    said = subprocess.run([found, "--version"], capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"Python {version}.")


def test_find_python_prints_nothing_where_there_is_none():
    assert find_python("9.98", "9.99") == ""


def test_pip_is_asked_for_another_platform_and_python():
    options = fetch_wheels.pip_options(platforms.Variant("windows-x64", "blender-5.1-or-later"))
    assert options == "--python-version 313 --implementation cp --platform win_amd64 pycolmap==4.2.1".split()


@pytest.mark.parametrize("script", sorted(TOOLS.glob("*.sh")), ids=lambda path: path.name)
def test_scripts_say_what_they_do_and_stop_at_errors(script):
    lines = script.read_text().splitlines()
    assert lines[0] == "#!/usr/bin/env bash" and lines[1].startswith("# ")
    assert any(line.startswith("set -") and "u" in line and "pipefail" in line for line in lines)
    subprocess.run(["bash", "-n", script], check=True)


def test_makefile_fits_one_screen():
    lines = (ROOT / "Makefile").read_text().splitlines()
    assert len(lines) <= 50 and max(map(len, lines)) <= 120
