"""Where packages and the native library come from: a batch needs nothing but a Python with numpy, and
wheels."""

from __future__ import annotations

import importlib.util
import json
import os
import platform
import re
import shutil
import subprocess
import sys
import zipfile
from pathlib import Path

import pytest

import native_wheel
import platforms
from svrgs_addon.native.library_path import LIBRARY_VARIABLE, library_path
from svrgs_addon.system import wheels
from svrgs_addon.system.errors import NativeError, SceneError
from svrgs_addon.system.here import LIBRARY

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("OpenImageIO", "pycolmap")
TAG = f"cp{sys.version_info[0]}{sys.version_info[1]}"
PLATFORM = f"manylinux_2_28_{platform.machine()}"
pytestmark = pytest.mark.skipif(sys.platform != "linux", reason="wheels for Linux")


# --- which wheel, and where it is unpacked


@pytest.fixture
def root(tmp_path, monkeypatch) -> Path:
    """Folder of a checkout without wheels. Of the packages this Python has numpy alone; the cache is an empty
    folder."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.setattr(wheels, "ROOT", tmp_path / "root")
    monkeypatch.setattr(wheels, "importable", lambda: {"numpy": Path("/numpy")})
    (tmp_path / "root/wheels").mkdir(parents=True)
    (tmp_path / "root/Makefile").touch()
    return tmp_path / "root"


def add_wheel(root: Path, package: str, tags: str = f"{TAG}-{TAG}-{PLATFORM}") -> Path:
    (root / "wheels").mkdir(parents=True, exist_ok=True)
    path = root / "wheels" / f"{package.lower()}-1.0-{tags}.whl"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        wheel.writestr(f"{package}/__init__.py", f"name = '{package}'\n" * 100)
    return path


def test_fitting_wheels_are_unpacked_once(root, tmp_path):
    for tags in (f"{TAG}-{TAG}-{PLATFORM}", f"cp39-cp39-{PLATFORM}", f"{TAG}-{TAG}-manylinux_2_28_other"):
        made = [add_wheel(root, name, tags) for name in NAMES]
    found = wheels.find()
    cache = tmp_path / "cache/svrgs"
    assert found == {"numpy": Path("/numpy")} | {
        name: cache / f"{name.lower()}-1.0-{TAG}-{TAG}-{PLATFORM}" for name in NAMES
    }
    assert len(list(cache.iterdir())) == 2
    assert all((found[name] / name / "__init__.py").is_file() for name in NAMES)
    for wheel in made:
        wheel.write_bytes(b"no longer read")
    assert wheels.find() == found


def test_folders_come_before_wheels_and_other_extensions_after_them(root, tmp_path):
    add_wheel(root, "pycolmap")
    (tmp_path / "blender/OpenImageIO").mkdir(parents=True)
    for name in NAMES:
        add_wheel(tmp_path / "extension", name).rename(
            tmp_path / "extension/wheels" / f"{name.lower()}-0.9-{TAG}-{TAG}-{PLATFORM}.whl"
        )
    assert wheels.find([tmp_path / "blender"])["OpenImageIO"] == tmp_path / "blender"
    found = wheels.find([], [tmp_path / "extension"])
    assert [found[name].name.split("-")[1] for name in NAMES] == ["0.9", "1.0"]


def test_a_process_that_was_quicker_is_no_error(root, tmp_path, monkeypatch):
    for name in NAMES:
        add_wheel(root, name)
    rename = Path.rename

    def late(made: Path, folder: Path):
        shutil.copytree(made, folder)
        return rename(made, folder)

    monkeypatch.setattr(Path, "rename", late)
    found = wheels.find()
    assert sorted(path.name for path in (tmp_path / "cache/svrgs").iterdir()) == sorted(
        found[name].name for name in NAMES
    )


@pytest.mark.parametrize(
    "damage",
    [lambda data: data[: len(data) // 2], lambda data: data[:60] + bytes(8) + data[68:]],
    ids=["cut", "changed"],
)
def test_a_damaged_wheel_leaves_nothing_behind(root, tmp_path, damage):
    add_wheel(root, "pycolmap")
    wheel = add_wheel(root, "OpenImageIO")
    wheel.write_bytes(damage(wheel.read_bytes()))
    with pytest.raises(
        SceneError, match=rf"{wheel.name}: is damaged \(.*\); delete it and run 'make wheels'"
    ):
        wheels.find()
    assert list((tmp_path / "cache/svrgs").iterdir()) == []


def test_what_a_killed_process_left_is_removed_after_an_hour(root, tmp_path):
    for name in NAMES:
        add_wheel(root, name)
    left, filling = (tmp_path / "cache/svrgs" / name for name in (".unpack-a", ".unpack-b"))
    for folder in (left, filling):
        (folder / "pycolmap").mkdir(parents=True)
    os.utime(left, (0, 0))
    wheels.find()
    assert not left.exists() and filling.exists()


def test_a_cache_that_cannot_be_written_is_named(root, tmp_path):
    add_wheel(root, "OpenImageIO")
    (tmp_path / "cache").write_text("a file")
    with pytest.raises(
        SceneError, match="cannot be unpacked into .*cache/svrgs.*; set XDG_CACHE_HOME to another folder"
    ):
        wheels.find()


@pytest.mark.parametrize(
    "tags, sentence",
    [
        (
            [],
            (
                "run 'make wheels' in .*root, or install the extension in this Blender, or run .* -m pip"
                " install OpenImageIO pycolmap"
            ),
        ),
        (
            [f"cp310-cp310-{PLATFORM}", f"cp39-cp39-{PLATFORM}"],
            r"root/wheels are for Python 3\.9, 3\.10: use a Blender with one of these, or run",
        ),
        ([f"{TAG}-{TAG}-manylinux_2_28_other"], "root/wheels are not for Linux"),
    ],
)
def test_what_is_missing_is_said_with_the_versions_that_fit(root, tags, sentence):
    for tag in tags:
        for name in NAMES:
            add_wheel(root, name, tag)
    found = wheels.find()
    assert list(found) == ["numpy"]
    assert re.search(
        rf"^Python {sys.version_info[0]}\.{sys.version_info[1]} \(.*\) lacks OpenImageIO and"
        rf" pycolmap.*{sentence}",
        wheels.missing(found),
    )
    assert wheels.missing(wheels.PACKAGES) == ""


def test_an_extension_without_wheels_names_the_other_zips_and_a_package_of_pip_names_pip(root):
    (root / "Makefile").unlink()
    assert re.search(
        "lacks OpenImageIO and pycolmap: run .* -m pip install OpenImageIO pycolmap$",
        wheels.missing(["numpy"]),
    )
    (root / "blender_manifest.toml").touch()
    assert (
        "lacks OpenImageIO and pycolmap: use a Blender with a Python for which there is a zip with packages,"
        " or run" in wheels.missing(["numpy"])
    )


def test_numpy_is_asked_of_the_system(root, monkeypatch):
    monkeypatch.setattr(wheels, "importable", dict)
    with pytest.raises(SceneError, match="lacks numpy.*on Debian the package python3-numpy"):
        wheels.find()


def test_the_native_library_may_be_that_of_an_extension(tmp_path, monkeypatch):
    monkeypatch.delenv(LIBRARY_VARIABLE, raising=False)
    assert library_path([tmp_path]) == ROOT / "svrgs_addon" / LIBRARY
    sentence = (
        r"the native library .*{} is missing: run 'make native' in a checkout, or install the extension's zip"
    )
    monkeypatch.setattr(
        "svrgs_addon.native.library_path.__file__", str(tmp_path / "checkout/native/library_path.py")
    )
    with pytest.raises(NativeError, match=sentence.format(f"checkout/{LIBRARY}")):
        library_path([tmp_path])
    (tmp_path / LIBRARY).touch()
    assert library_path([tmp_path / "none", tmp_path]) == tmp_path / LIBRARY
    monkeypatch.setenv(LIBRARY_VARIABLE, str(tmp_path / "gone.so"))
    with pytest.raises(NativeError, match=sentence.format("gone.so")):
        library_path([tmp_path])


# --- a batch in a Python that has only numpy


@pytest.fixture(scope="module")
def bare(tmp_path_factory) -> Path:
    """A Python of this version with numpy and no other package. Wheels for it must be in wheels/."""
    if len(fitting_wheels()) < 2:
        pytest.skip(
            f"wheels/ has not both packages for {TAG}: make wheels, with a Python for which there are wheels"
        )
    folder = tmp_path_factory.mktemp("bare")
    subprocess.run([sys.executable, "-m", "venv", "--without-pip", folder], check=True)
    (site_packages,) = folder.glob("lib/python*/site-packages")
    for path in Path(importlib.util.find_spec("numpy").origin).parents[1].glob("numpy*"):
        (site_packages / path.name).symlink_to(path)
    return folder / "bin/python"


def fitting_wheels() -> list[Path]:
    """Those in wheels/ for this platform and this Python."""
    try:
        return sorted(platforms.variant_for(TAG).wheels())
    except FileNotFoundError:
        return []


@pytest.fixture
def checkout(tmp_path) -> Path:
    """A copy of the package without wheels and without the native library."""
    shutil.copytree(
        ROOT / "svrgs_addon",
        tmp_path / "checkout/svrgs_addon",
        ignore=shutil.ignore_patterns("__pycache__", LIBRARY),
    )
    (tmp_path / "checkout/Makefile").touch()
    return tmp_path / "checkout"


def start(command: list, cache: Path, **variables: object) -> subprocess.Popen:
    environment = {
        name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", LIBRARY_VARIABLE)
    }
    environment |= {"XDG_CACHE_HOME": str(cache)} | {name: str(value) for name, value in variables.items()}
    return subprocess.Popen(
        [str(word) for word in command],
        env=environment,
        cwd="/",
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )


def finish(process: subprocess.Popen) -> tuple[int, str, str]:
    out, err = process.communicate(timeout=120)
    return process.returncode, out, err


def prune(python: list, batch: Path, tiny, out: Path) -> list:
    words = f"prune {tiny.folder} --out {out} --iterations 10 --recovery 5 --target 0.5 --quiet".split()
    return [*python, batch, "--", *words]


@pytest.mark.slow
def test_two_batches_at_once_need_numpy_and_wheels_alone(bare, tiny, tmp_path):
    batch = ROOT / "svrgs_addon/batch.py"
    both = [
        start(prune([bare], batch, tiny, tmp_path / name), tmp_path / "cache") for name in ("a.ply", "b.ply")
    ]
    for status, out, err in map(finish, both):
        assert (status, json.loads(out)["count"], err) == (0, 125, "")
    fitting = fitting_wheels()
    assert sorted(path.name for path in (tmp_path / "cache/svrgs").iterdir()) == [
        wheel.stem for wheel in fitting
    ]
    for wheel in fitting:
        with zipfile.ZipFile(wheel) as archive:
            folder = tmp_path / "cache/svrgs" / wheel.stem
            assert all(
                (folder / item.filename).stat().st_size == item.file_size
                for item in archive.infolist()
                if not item.is_dir()
            )


def test_a_checkout_without_wheels_or_library_says_what_to_do(bare, tiny, checkout, tmp_path):
    command = prune([bare], checkout / "svrgs_addon/batch.py", tiny, tmp_path / "out.ply")
    status, out, err = finish(start(command, tmp_path / "cache"))
    assert (status, out, err.count("\n")) == (1, "", 1) and "libsvrgs.so is missing: run 'make native'" in err
    shutil.copy2(library_path(), checkout / "svrgs_addon")
    status, out, err = finish(start(command, tmp_path / "cache"))
    assert status == 1 and re.search(
        f"needs the package .*: Python .* lacks .*: run 'make wheels' in {checkout}", json.loads(out)["error"]
    ), err


@pytest.mark.slow
def test_blender_lends_what_a_checkout_lacks(bare, tiny, checkout, tmp_path):
    """Wheels and library of the installed extension, which is not enabled; OpenImageIO of Blender as a
    module."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or subprocess.run([sys.executable, "-c", "import bpy"], capture_output=True).returncode:
        pytest.skip("Blender as a module is not installed, or cannot be imported")
    extension = tmp_path / "user/extensions/user_default/svrgs"
    (extension / "wheels").mkdir(parents=True)
    for wheel in (ROOT / "wheels").iterdir():
        (extension / "wheels" / wheel.name).symlink_to(wheel)
    native_wheel.write(ROOT / "svrgs_addon" / LIBRARY, platforms.this_platform(), extension / "wheels")
    code = (
        "import sys, runpy; sys.path.append(sys.argv.pop(1)); import bpy; runpy.run_path(sys.argv[1],"
        " run_name='__main__')"
    )
    (tmp_path / "modules").mkdir()
    (tmp_path / "modules/bpy").symlink_to(Path(spec.origin).parent)
    command = prune(
        [bare, "-c", code, tmp_path / "modules"],
        checkout / "svrgs_addon/batch.py",
        tiny,
        tmp_path / "out.ply",
    )
    status, out, err = finish(start(command, tmp_path / "cache", BLENDER_USER_RESOURCES=tmp_path / "user"))
    assert status == 0, err
    assert json.loads(out.splitlines()[-1])["count"] == 125
    bundled = list(Path(spec.origin).parent.glob("*/python/lib/python*/site-packages/OpenImageIO"))
    assert [path.name.split("-")[0] for path in sorted((tmp_path / "cache/svrgs").iterdir())] == [
        "openimageio",
        "pycolmap",
        "svrgs_native",
    ][bool(bundled) :]
