"""Names and lengths of paths: what Windows forbids, and folders of 300 characters with spaces and umlauts
through whole commands."""

from __future__ import annotations

import json
import os
import shutil
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace

import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from svrgs_addon.files.atomic import atomic_write, check_writable
from svrgs_addon.system import here
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.system.exit_status import plain, printable
from svrgs_addon.system.file_names import extended, is_link, shown, what_is_forbidden

ROOT = Path(__file__).resolve().parents[1]
FOLDER = "Ordner mit Größe, ü & 100 %"  # 27 characters
SHORT = ("--iterations", "3", "--recovery", "3", "--quiet")
LONG = "C:\\" + "x" * 244


@pytest.mark.parametrize(
    "path, reason",
    [
        ("out/NUL.ply", "on Windows, 'NUL.ply' is a device and no file"),
        ("con", "on Windows, 'con' is a device and no file"),
        ("COM1 .x/a.ply", "on Windows, 'COM1 .x' is a device and no file"),
        ("C:\\out\\lpt9.tar.gz", "on Windows, 'lpt9.tar.gz' is a device and no file"),
        ("C:\\out\\a:b.ply", "Windows does not allow ':' in a name"),
        ("what?.ply", "Windows does not allow '?' in a name"),
        ("a\x1f.ply", "Windows does not allow '\\x1f' in a name"),
        ("out /a.ply", "Windows does not allow a name that ends with a space"),
        ("a.ply.", "Windows does not allow a name that ends with a dot"),
    ],
)
def test_a_name_that_windows_forbids_is_refused(windows, tmp_path, path, reason):
    assert what_is_forbidden(path) == reason
    with pytest.raises(SceneError) as caught:
        check_writable(path)
    assert str(caught.value) == f"{path}: cannot be written because {reason}; choose another name"


def test_other_names_are_allowed(windows):
    paths = "C:\\out\\console.ply", "..\\.\\nulls\\.a\\b c.ply", "\\\\server\\share\\größe.ply"
    for path in (*paths, "COM0.ply", "com10", LONG):
        assert what_is_forbidden(path) == "", path


@pytest.mark.skipif(sys.platform == "win32", reason="this is Windows")
def test_other_systems_forbid_nothing():
    assert what_is_forbidden("NUL./a:b ") == "" and extended("/" + "x" * 300) == Path("/" + "x" * 300)
    assert shown("\\\\?\\a") == "\\\\?\\a"


@pytest.mark.parametrize(
    "path, opened",
    [
        (LONG, LONG),
        (LONG + "y", "\\\\?\\" + LONG + "y"),
        (LONG + "\\.\\z\\..\\y/ü.ply", "\\\\?\\" + LONG + "\\y\\ü.ply"),
        ("\\\\server\\share\\" + "x" * 300, "\\\\?\\UNC\\server\\share\\" + "x" * 300),
        ("\\\\?\\" + LONG + "y", "\\\\?\\" + LONG + "y"),
        ("C:\\short.ply", "C:\\short.ply"),
        ("short/x.ply", str(Path("short/x.ply"))),
    ],
)
def test_a_long_path_of_windows_gets_the_prefix(windows, path, opened):
    assert str(extended(path)) == opened


def test_a_relative_path_is_measured_from_the_current_folder(windows, monkeypatch):
    monkeypatch.setattr(os, "getcwd", lambda: LONG)
    assert str(extended("ü.ply")) == "\\\\?\\" + LONG + "\\ü.ply"


def test_messages_show_the_path_without_the_prefix(windows):
    name, share = f"{LONG}\\größe.ply", "\\\\server\\share\\" + "x" * 300
    path = extended(name)
    assert printable(str(FileNotFoundError(2, "missing", str(path)))) == f"[Errno 2] missing: {name!r}"
    said = f"{path}: is incomplete"
    assert str(FormatError(said)) == printable(said) == f"{name}: is incomplete"
    stored = {"out": str(extended(share)), "files": [str(path)]}
    assert plain(stored) == {"out": share, "files": [name]}


@pytest.mark.skipif(sys.platform == "win32", reason="only Windows has drives")
def test_a_drive_that_is_missing_is_one_sentence(windows, monkeypatch):
    monkeypatch.setattr(os.path, "lexists", lambda _: False)
    with pytest.raises(SceneError, match="there is no drive"):
        check_writable("/q/a.ply")


def test_a_junction_of_windows_is_a_link(tmp_path, monkeypatch):
    tags, mode = {"junction": 0xA0000003, "in the cloud": 0x9000001A, "folder": 0}, tmp_path.stat().st_mode
    for name in tags:
        (tmp_path / name).mkdir()
    facts = lambda path: SimpleNamespace(st_reparse_tag=tags[Path(path).name], st_mode=mode)
    monkeypatch.setattr(os, "lstat", facts)
    with os.scandir(tmp_path) as entries:
        assert sorted(entry.name for entry in entries if is_link(entry)) == ["junction"]


# --- on this system


def test_a_name_may_be_as_long_as_the_system_allows(tmp_path):
    for name in ("x" * 251 + ".ply", "x." + "y" * 250):
        check_writable(tmp_path / name)
        with atomic_write(tmp_path / name) as file:
            file.write(b"content")
        assert [path.name for path in tmp_path.iterdir()] == [name]
        (tmp_path / name).unlink()


@pytest.fixture
def place(tiny, tmp_path) -> Path:
    """A folder whose path has more than 300 characters, with the tiny dataset and its splat."""
    folder = tmp_path
    while len(str(folder)) < 300:
        folder = folder / FOLDER
    shutil.copytree(str(tiny.folder), str(extended(folder)))
    yield folder
    shutil.rmtree(extended(tmp_path / FOLDER))


def run(*words: object, **environment: str) -> subprocess.CompletedProcess[bytes]:
    return subprocess.run(
        [sys.executable, "-m", "svrgs_addon", *map(str, words)],
        cwd=ROOT,
        capture_output=True,
        env=os.environ | environment,
    )


COMMANDS = {
    "info": "info {}/scene.ply",
    "render": "render {}/scene.ply --data {} --views test --out {}/out",
    "prune": (
        "prune {}/scene.ply --data {} --iterations 3 --recovery 3 --quiet --out {}/ö.ply --report {}/report"
    ),
    "batch": "prune {} --iterations 3 --recovery 3 --quiet --batch --out {}/ö.ply",
    "train": "train --data {} --iterations 3 --quiet --out {}/ö.ply",
    "eval": "eval {}/scene.ply --data {}",
    "compare": "compare {}/scene.ply {}/scene.ply --data {} --out {}/out",
}


@pytest.mark.parametrize(
    "console",
    [
        pytest.param({"PYTHONIOENCODING": "cp1252"}, id="cp1252", marks=pytest.mark.slow),
        pytest.param({"LC_ALL": "C", "PYTHONCOERCECLOCALE": "0"}, id="C"),
    ],
)
@pytest.mark.parametrize(
    "command",
    [
        pytest.param(name, marks=() if name in ("info", "prune", "batch") else pytest.mark.slow)
        for name in COMMANDS
    ],
)
def test_long_paths_with_umlauts_and_spaces(place, command, console):
    words = [word.format(*[place] * 4) for word in COMMANDS[command].split()]
    done = run(*words, *(["--json"] if command in ("prune", "compare") else []), **console)
    assert done.returncode == 0 and b"Traceback" not in done.stderr, done.stderr
    assert b"\\\\?\\" not in done.stdout.replace(b"\\\\\\\\", b"\\\\")
    if command in ("prune", "batch"):
        result = json.loads(done.stdout)
        assert result["out"] == str(place / "ö.ply") and extended(place / "ö.ply").is_file()
    left = list(extended(place).iterdir())
    assert not any(path.name.startswith(".svrgs-") or path.suffix == ".job" for path in left)


def test_a_sentence_on_a_console_that_lacks_the_letters(tmp_path):
    done = run("info", tmp_path / "größe-λ.ply", PYTHONIOENCODING="cp850")
    assert done.returncode == 2
    assert "größe-".encode("cp850") + rb"\u03bb.ply: there is no such file" in done.stderr


def test_the_system_is_known():
    assert (here.LIBRARY, here.WHEEL) == {
        "win32": ("svrgs.dll", "win"), "darwin": ("libsvrgs.dylib", "macosx")
    }.get(sys.platform, ("libsvrgs.so", "manylinux"))  # fmt: skip
