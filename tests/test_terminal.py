"""The command line in any terminal: paths and encodings that are not UTF-8, closed streams, control
characters, Ctrl-C at the start."""

from __future__ import annotations

import io
import json
import os
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from colmap_model import write_colmap
from svrgs_addon.finetune.loop import Progress
from svrgs_addon.prune.progress import Reporter
from svrgs_addon.system.exit_status import printable

ROOT = Path(__file__).resolve().parents[1]
NAME = os.fsdecode(b"caf\xe9")  # Latin-1: not UTF-8
SHORT = ("--iterations", "3", "--recovery", "3", "--quiet")

pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")


def run(*words: object, redirect: str = "", **environment: str) -> subprocess.CompletedProcess[bytes]:
    """`svrgs WORDS` in a process of its own, with redirections of a shell."""
    shell = ["sh", "-c", f'exec "$@" {redirect}', "sh"]
    command = [*shell, sys.executable, "-m", "svrgs_addon", *map(str, words)]
    return subprocess.run(command, cwd=ROOT, capture_output=True, env=os.environ | environment)


@pytest.fixture
def place(tiny, tmp_path) -> Path:
    """A folder whose name is not UTF-8, with the tiny dataset and its splat."""
    shutil.copytree(tiny.folder, tmp_path / NAME)
    return tmp_path / NAME


COMMANDS = {  # words, and the file whose name is printed
    "render": ("render {}/scene.ply --data {} --views test --out {}/out", "out/08.rgb.png"),
    "compare": ("compare {}/scene.ply {}/scene.ply --data {} --out {}/out", "out/index.html"),
    "prune": (
        (
            "prune {}/scene.ply --data {} --iterations 3 --recovery 3 --quiet --out {}/o.ply --report"
            " {}/report"
        ),
        "o.ply",
    ),
    "train": ("train --data {} --iterations 3 --quiet --out {}/o.ply", "o.ply"),
    "eval": ("eval {}/scene.ply --data {}", ""),
}


@pytest.mark.slow
@pytest.mark.parametrize("encoding", ["utf-8", "ascii"])
@pytest.mark.parametrize("command", COMMANDS)
def test_paths_need_not_be_utf_8(place, command, encoding):
    line, printed = COMMANDS[command]
    words = [word.format(*[place] * 4) for word in line.split()]
    done = run(*words, PYTHONIOENCODING=encoding)
    assert (done.returncode, done.stderr) == (0, b"")
    if printed:
        assert os.fsencode(place / printed) in done.stdout and (place / printed).is_file()
    result = json.loads(run(*words, "--json", PYTHONIOENCODING=encoding).stdout)
    assert not printed or str(place / printed) in (
        result.get("out"),
        result.get("report"),
        *result.get("files", ()),
    )


def test_a_page_shows_a_name_that_is_not_utf_8(place):
    (place / "scene.ply").rename(place / f"{NAME}.ply")
    outputs = ("--out", place / "o.ply", "--report", place / "report")
    assert run("prune", place / f"{NAME}.ply", "--data", place, *SHORT, *outputs).returncode == 0
    page = (place / "report/index.html").read_text(encoding="utf-8")
    assert "<h1>caf\N{REPLACEMENT CHARACTER}</h1>" in page


def test_a_sentence_names_the_path_as_it_is(place):
    done = run("info", place / "none.ply")
    assert (
        done.returncode == 2
        and done.stderr
        == b"svrgs: " + os.fsencode(place / "none.ply") + b": there is no such file; check the path\n"
    )


def test_letters_that_an_encoding_lacks_are_escaped(tiny, tmp_path):
    done = run("info", tmp_path / "λ.ply", PYTHONIOENCODING="ascii")
    assert done.returncode == 2 and rb"/\u03bb.ply: there is no such file" in done.stderr
    assert b"Traceback" not in done.stderr


def test_a_photograph_that_is_not_utf_8_is_named(place):
    (place / "images/00.png").write_bytes(b"\x89PNG no image")
    done = run("eval", place / "scene.ply", "--data", place)
    assert done.returncode == 2
    assert os.fsencode(place / "images/00.png") + b": cannot be read as an image" in done.stderr


@pytest.mark.parametrize(
    "redirect, printed",
    [
        ("2>&-", True),
        pytest.param(">&-", False, marks=pytest.mark.slow),
        pytest.param(">&- 2>&-", False, marks=pytest.mark.slow),
        ("<&- >&- 2>&-", False),
    ],
)
def test_streams_may_be_closed(tiny, tmp_path, redirect, printed):
    """The first file that is opened would otherwise get the number of stderr, and libraries would write their
    messages into it."""
    words = f"prune {tiny.splat} --data {tiny.folder} --iterations 3 --recovery 3 --json --out".split()
    open_, closed = run(*words, tmp_path / "a.ply"), run(*words, tmp_path / "b.ply", redirect=redirect)
    assert open_.returncode == closed.returncode == 0
    assert (tmp_path / "a.ply").read_bytes() == (tmp_path / "b.ply").read_bytes()
    assert json.loads(closed.stdout)["count"] > 0 if printed else closed.stdout == b""


# --- control characters


def red(place: Path) -> str:
    """Gives all photographs names that would colour a terminal; returns the first."""
    cameras = [replace(camera, name=f"\x1b[31m{camera.name}") for camera in tiny_dataset.views()]
    write_colmap(place / "sparse/0", cameras, np.zeros((9, 3)))
    for camera in cameras:
        (place / "images" / camera.name[5:]).rename(place / "images" / camera.name)
    return cameras[0].name


@pytest.mark.parametrize(
    "command",
    [
        "render",
        pytest.param("views", marks=pytest.mark.slow),
        pytest.param("missing", marks=pytest.mark.slow),
        "batch",
        pytest.param("broken", marks=pytest.mark.slow),
        "usage",
    ],
)
def test_names_do_not_command_the_terminal(place, command):
    name = red(place)
    words = ["eval", place / "scene.ply", "--data", place]
    if command in ("render", "views"):
        views = "test" if command == "render" else "77"
        words = f"render {place}/scene.ply --data {place} --out {place}/out --views {views}".split()
    elif command in ("missing", "batch"):  # a batch has a process for each scene
        (place / "images" / name).unlink()
        if command == "batch":
            words = ["prune", *words[1:], *SHORT, "--batch", "--out", place / "o.ply"]
    elif command == "broken":
        (place / "images" / name).write_bytes(b"no image")
    else:
        words.append(f"--{name}")
    done = run(*words)
    assert b"\x1b" not in done.stdout + done.stderr and b"[31m" in done.stdout + done.stderr


def test_control_characters_are_escaped():
    assert printable("a\x1b[31m\n\x9b\u202eλ é\udce9") == "a\\x1b[31m\\n\\x9b\\u202eλ é\udce9"


def test_what_a_file_says_is_not_repeated_at_any_length():
    said = printable("a.ply: " + "x" * 100_000 + " is no name")
    assert len(said) < 2_000 and said.startswith("a.ply: x") and said.endswith("x is no name")
    assert printable("y" * 1_500) == "y" * 1_500


@pytest.mark.skipif(sys.platform == "win32", reason="a pipe of sh")
def test_who_reads_no_more_is_told_nothing(tiny):
    words = f"{sys.executable} -m svrgs_addon info {tiny.splat} | true"
    for _ in range(3):
        done = subprocess.run(["sh", "-c", words], cwd=ROOT, capture_output=True, text=True)
        assert (done.returncode, done.stdout, done.stderr) == (0, "", "")


# --- Ctrl-C at the start

INTERRUPTED = """
import os, signal, sys
from importlib.abc import MetaPathFinder
from svrgs_addon.cli.main import main

class CtrlC(MetaPathFinder):
    def find_spec(self, name, path, target=None):
        if name == sys.argv[1]:
            os.kill(os.getpid(), signal.SIGINT)

sys.meta_path.insert(0, CtrlC())
name = sys.argv[1]
sys.exit(main(sys.argv[2:]))
"""


@pytest.mark.parametrize(
    "module",
    "svrgs_addon.cli.terminal argparse svrgs_addon.cli.commands datetime numpy.linalg pycolmap._core".split(),
)
def test_ctrl_c_while_modules_are_imported(tiny, module):
    words = f"{module} render {tiny.splat} --data {tiny.folder} --out {tiny.folder}/none".split()
    command = [sys.executable, "-c", INTERRUPTED, *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True)
    assert (done.returncode, done.stdout, done.stderr) == (130, "", "svrgs: interrupted\n")


# --- progress


@pytest.mark.parametrize("columns, bars", [(120, True), (80, False), (30, False)])
def test_a_progress_line_fits_into_the_terminal_and_replaces_the_last_one(monkeypatch, columns, bars):
    terminal = io.StringIO()
    terminal.isatty = lambda: True
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setenv("COLUMNS", str(columns))
    report = Reporter()
    for iteration, count in ((99, 1_000_000), (100, 5)):
        report._next = 0.0
        report(Progress(iteration, 100, "prune", "pruning", count, 0.5, 10.0, 7.0))
    first, second = terminal.getvalue().removeprefix("\r").rstrip("\n").split("\r")
    assert len(first) == len(second) < columns and ("[" in first) == bars
    assert first.strip().startswith(("[", "prune 99/100"))
    assert second.rstrip() != second or columns == 30, "spaces clear the rest of the longer line"
