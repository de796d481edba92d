"""The scripts of tools/, the Makefile that calls them, and what stays out of the extension."""

from __future__ import annotations

import runpy
import subprocess
import sys
import tomllib
from fnmatch import fnmatch
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
TOOLS = ROOT / "tools"
IN_THE_EXTENSION = {"LICENSE", "__init__.py", "blender_manifest.toml", "operators", "panels", "svrgs_addon"}


def find_python(*versions: str) -> str:
    return subprocess.run([TOOLS / "find_python.sh", *versions], capture_output=True, text=True, check=True).stdout.strip()


def test_find_python_takes_the_first_that_runs():
    version = f"{sys.version_info.major}.{sys.version_info.minor}"
    found = find_python("9.99", version)
    if not found:
        pytest.skip(f"no python{version} on PATH")
    said = subprocess.run([found, "--version"], capture_output=True, text=True, check=True).stdout
    assert said.startswith(f"Python {version}.")


def test_find_python_prints_nothing_where_there_is_none():
    assert find_python("9.98", "9.99") == ""


def test_pip_options_name_the_wheel():
    options = runpy.run_path(str(TOOLS / "fetch_wheels.py"))["pip_options"]
    wheel = "openimageio-3.0.21.0-cp311-cp311-manylinux_2_27_x86_64.manylinux_2_28_x86_64.whl"
    assert options(wheel) == ["openimageio==3.0.21.0", "--python-version", "311", "--platform", "manylinux_2_28_x86_64"]


@pytest.mark.parametrize("script", sorted(TOOLS.glob("*.sh")), ids=lambda path: path.name)
def test_scripts_say_what_they_do_and_stop_at_errors(script):
    lines = script.read_text().splitlines()
    assert lines[0] == "#!/usr/bin/env bash" and lines[1].startswith("# ")
    assert any(line.startswith("set -") and "u" in line and "pipefail" in line for line in lines)
    subprocess.run(["bash", "-n", script], check=True)


def test_makefile_fits_one_screen():
    lines = (ROOT / "Makefile").read_text().splitlines()
    assert len(lines) <= 50 and max(map(len, lines)) <= 120


def test_only_the_extension_is_in_its_zip():
    """By the manifest's patterns: a new file beside these must be excluded, or be added here."""
    listed = subprocess.run(["git", "ls-files"], cwd=ROOT, capture_output=True, text=True)
    if listed.returncode:
        pytest.skip("this is no git checkout")
    patterns = tomllib.loads((ROOT / "blender_manifest.toml").read_text())["build"]["paths_exclude_pattern"]
    top = {line.split("/")[0] for line in listed.stdout.splitlines()}
    kept = {name for name in top if not any(fnmatch(name, pattern.strip("/")) for pattern in patterns)}
    assert kept == IN_THE_EXTENSION
