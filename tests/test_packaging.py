"""The zips and wheels of `make package`: which there are, what their manifests say, what those in dist/
hold."""

from __future__ import annotations

import importlib.util
import os
import subprocess
import sys
import tomllib
import venv
import zipfile
from pathlib import Path

import pytest

import build_extension
import native_wheel
import platforms
from svrgs_addon.system import here
from svrgs_bench import variants

ROOT = Path(__file__).resolve().parents[1]
DIST = ROOT / "dist"
NAMES = {
    "pycolmap==4.2.1": "pycolmap-4.2.1-{0}-{0}-{1}.whl",
    "openimageio==3.0.21.0": "openimageio-3.0.21.0-{0}-{0}-{1}.whl",
    "openimageio==3.2.2.0": "openimageio-3.2.2.0-{0}-{0}-{1}.whl",
}  # fmt: skip
LIMIT = 60e6  # bytes of a zip


@pytest.fixture
def wheels(tmp_path, monkeypatch) -> Path:
    """A folder with an empty file for each wheel of the table."""
    for variant in platforms.variants():
        for package in variant.facts["packages"]:
            tag = platforms.TABLE["platform"][variant.platform]["wheels"][-1]
            (tmp_path / NAMES[package].format(variant.facts["python"], tag)).touch()
    monkeypatch.setattr(platforms, "WHEELS", tmp_path)
    return tmp_path


def manifest(variant: platforms.Variant) -> dict:
    return tomllib.loads(build_extension.manifest(variant, Path(__file__)))  # any file for a library


def test_every_platform_has_a_zip_for_any_python():
    without = [variant.platform for variant in platforms.variants() if variant.blender == "any-python"]
    assert without == list(platforms.TABLE["platform"])
    assert {variant.platform for variant in platforms.variants() if variant.facts["packages"]} == {
        "linux-x64",
        "windows-x64",
        "macos-arm64",
    }


def test_manifests_differ_in_platform_blenders_and_wheels_alone(wheels):
    template = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
    added = {"version", "platforms", "wheels", "blender_version_min", "blender_version_max"}
    for variant in platforms.variants():
        made = manifest(variant)
        assert {key: made[key] for key in made if key not in added} == template
        assert made["platforms"] == [variant.platform] and made["blender_version_min"] == variant.facts["min"]
        assert made.get("blender_version_max") == variant.facts.get("max")
        native, *others = made["wheels"]
        assert native.startswith(f"./wheels/svrgs_native-{platforms.VERSION}-0")
        assert len(others) == len(variant.facts["packages"])
        assert all(
            variant.facts["python"] in wheel and (wheels / Path(wheel).name).exists() for wheel in others
        )


def test_zips_of_one_platform_for_different_blenders_have_different_versions():
    """The public repository takes no second one of the same version; a Blender that is updated finds a newer
    one."""
    versions = {
        variant.blender: variant.version
        for variant in platforms.variants()
        if variant.platform == "linux-x64"
    }
    older, newer = versions["blender-4.2-to-5.0"], versions["blender-5.1-or-later"]
    assert older == versions["any-python"] == platforms.VERSION and older < newer
    assert int(platforms.VERSION.rpartition(".")[2]) % 2 == 0, "or the next release has the version of a zip"


def test_no_two_zips_of_the_repository_fit_one_blender():
    """Of the same platform and Python. Blender reads the Python from the names of the wheels."""
    found = [
        (variant.platform, variant.facts.get("python"))
        for variant in platforms.variants()
        if build_extension.in_repository(variant)
    ]
    assert len(found) == len(set(found))
    assert {platform for platform, _ in found} == set(platforms.TABLE["platform"])


def test_a_missing_wheel_is_named(tmp_path, monkeypatch):
    monkeypatch.setattr(platforms, "WHEELS", tmp_path)
    with pytest.raises(
        FileNotFoundError,
        match=r"pycolmap 4\.2\.1 for windows-x64, cp313 is not in .*: run tools/fetch_wheels.py --all",
    ):
        platforms.Variant("windows-x64", "blender-5.1-or-later").wheels()


@pytest.mark.parametrize("python", ["cp311", "cp310"])
def test_a_python_without_wheels_gets_the_zip_without(python, monkeypatch):
    monkeypatch.setattr(platforms, "this_platform", lambda: "linux-x64")
    assert (
        platforms.variant_for(python).blender
        == {"cp311": "blender-4.2-to-5.0", "cp310": "any-python"}[python]
    )


@pytest.mark.skipif(sys.platform == "win32", reason="the library has another name")
def test_what_a_zip_will_hold(tmp_path):
    variant = platforms.Variant("windows-x64", "any-python")
    (tmp_path / "built.dll").write_bytes(b"a library")
    build_extension.stage(variant, tmp_path / "built.dll", tmp_path / "stage")
    assert {path.name for path in (tmp_path / "stage").iterdir()} == {
        *build_extension.PRODUCT,
        "blender_manifest.toml",
        "LICENSES.txt",
        "manual",
        "wheels",
    }
    assert not list((tmp_path / "stage").rglob("__pycache__"))
    (wheel,) = (tmp_path / "stage/wheels").iterdir()
    with zipfile.ZipFile(wheel) as opened:
        assert opened.read("svrgs_native/built.dll") == b"a library"


def test_the_native_wheel_is_one_that_pip_installs(tmp_path):
    """For any Python, with the library of this checkout; and the same bytes each time."""
    library, platform = platforms.ROOT / "svrgs_addon" / here.LIBRARY, platforms.this_platform()
    wheel = native_wheel.write(library, platform, tmp_path)
    assert wheel.read_bytes() == native_wheel.write(library, platform, tmp_path / "again").read_bytes()
    pip = [sys.executable, "-m", "pip", "install", "-q", "--no-deps", "--no-index", "--target"]
    subprocess.run([*pip, tmp_path / "into", wheel], check=True)
    installed = tmp_path / "into/svrgs_native" / here.LIBRARY
    assert installed.read_bytes() == library.read_bytes()
    assert (tmp_path / f"into/svrgs_native-{platforms.VERSION}.dist-info/licenses/LICENSE").exists()


# --- the wheel for pip


@pytest.mark.slow
def test_an_installed_wheel_needs_no_compiler(tmp_path):
    """Built here by the compiler of this machine, installed into an empty environment, used from another
    folder."""
    if reason := variants.missing_tools() or (
        "" if importlib.util.find_spec("scikit_build_core") else "scikit-build-core is not installed"
    ):
        pytest.skip(reason)
    environment = os.environ | {
        "PATH": f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}",
        "PYTHONPATH": "",
    }
    build = [
        sys.executable,
        "-m",
        "pip",
        "wheel",
        "-q",
        "--no-deps",
        "--no-build-isolation",
        "-w",
        tmp_path,
        "-C",
        f"build-dir={tmp_path}/build",
        "-C",
        "cmake.define.CMAKE_CXX_FLAGS_RELEASE=-O0",  # compiles in a quarter of the time
        "-C",
        "cmake.define.avx=OFF",
        ROOT,
    ]
    subprocess.run(build, env=environment, check=True)
    (wheel,) = tmp_path.glob("*.whl")
    assert wheel.name.startswith(f"svrgs_addon-{platforms.VERSION}-py3-none-")
    python = tmp_path / "env/bin/python"
    venv.create(tmp_path / "env", system_site_packages=True, symlinks=True)
    install = [sys.executable, "-m", "pip", "--python", python, "install", "-q", "--no-deps", "--no-index"]
    subprocess.run([*install, "--force-reinstall", wheel], env=environment, check=True)
    code = (
        "import svrgs_addon, svrgs_addon.native.library as n; print(svrgs_addon.__version__,"
        " svrgs_addon.__file__, n.best_level() in n.supported_levels())"
    )
    done = subprocess.run([python, "-c", code], env=environment, cwd=tmp_path, capture_output=True, text=True)
    version, file, works = done.stdout.split()
    assert (version, works) == (platforms.VERSION, "True") and Path(file).is_relative_to(tmp_path / "env"), (
        done.stderr
    )
    assert (
        subprocess.run(
            [tmp_path / "env/bin/svrgs", "--version"],
            env=environment,
            cwd=tmp_path,
            capture_output=True,
            text=True,
        ).stdout.strip()
        == version
    )


# --- what `make package` has made


def wheel_for_pip(platform: str) -> Path:
    return (
        DIST
        / "wheels"
        / f"svrgs_addon-{platforms.VERSION}-py3-none-{platforms.TABLE['platform'][platform]['pip']}.whl"
    )


@pytest.fixture(scope="module")
def packaged() -> dict[platforms.Variant, Path]:
    made = {variant: DIST / f"{variant.name}.zip" for variant in platforms.variants()}
    if missing := [
        path
        for path in (*made.values(), *map(wheel_for_pip, platforms.TABLE["platform"]))
        if not path.exists()
    ]:
        pytest.skip(f"'make package' has not made {missing[0].relative_to(ROOT)} yet")
    return made


def contents(archive: Path) -> dict[str, int]:
    """{name: checksum} of the files in a zip or wheel."""
    with zipfile.ZipFile(archive) as opened:
        return {info.filename: info.CRC for info in opened.infolist() if not info.is_dir()}


def test_packaged_zips_differ_in_manifest_wheels_and_their_licences_alone(packaged):
    common = set()
    for path in packaged.values():
        assert path.stat().st_size <= LIMIT
        files = contents(path)
        own = {
            "blender_manifest.toml",
            "LICENSES.txt",
            *(name for name in files if name.startswith("wheels/")),
        }
        common.add(frozenset((name, crc) for name, crc in files.items() if name not in own))
    assert len(common) == 1


def test_packaged_wheels_hold_the_library_of_the_zip(packaged):
    for name in platforms.TABLE["platform"]:
        wheel = wheel_for_pip(name)
        variant = platforms.Variant(name, "any-python")
        library = f"svrgs_addon/{variant.library}"
        assert [path for path in contents(wheel) if path.endswith((".so", ".dll", ".dylib"))] == [library]
        build = f"0{contents(wheel)[library]:08x}"  # the checksum of the library
        assert [path.split("-")[2] for path in contents(packaged[variant]) if "svrgs_native" in path] == [
            build
        ]
