"""The extension as a user has it: built and installed by Blender's own tools. tests/blender runs in a fresh
process for each Blender.

Environment: SVRGS_BLENDER_PYTHONS, paths with ':' between: Pythons with other versions of bpy (`make
test-blender`). SVRGS_BLENDER_TESTS: only these tests of tests/blender, with further arguments of pytest:
"test_prune.py -k threads". The wheels must have been fetched (`make zip`); otherwise most of these tests are
skipped.
"""

from __future__ import annotations

import functools
import os
import re
import shlex
import subprocess
import sys
import sysconfig
import tomllib
import venv
import zipfile
from collections.abc import Iterable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import build_extension
import platforms
from svrgs_addon.viewer.web_page import MODULES

ROOT = Path(__file__).resolve().parents[1]
MANIFEST = tomllib.loads((ROOT / "blender_manifest.toml").read_text(encoding="utf-8"))
PYTHONS = [sys.executable, *filter(None, os.environ.get("SVRGS_BLENDER_PYTHONS", "").split(":"))]
BLENDER_TESTS = ROOT / "tests/blender"
PARTS = 5  # Blenders that share all tests
SHORT = ("test_manners.py", "test_formats.py", "-k", "not 50_times")  # what `make test` runs of them
ASK_PYTHON = "import sys; print('python tag: cp%d%d' % sys.version_info[:2])"


@pytest.fixture(scope="module")
def extension_zip(tmp_path_factory):
    """Function that builds and validates the zip for this platform and the Python of a program. It is given
    the program's words up to the code."""
    if build_extension.builder() is None:
        pytest.skip("bpy is not installed, and with it Blender's builder of extensions")

    @functools.cache
    def built(*program: str) -> Path:
        done = subprocess.run([*program, ASK_PYTHON], capture_output=True, text=True)
        variant = platforms.variant_for(re.search("python tag: (cp[0-9]+)", done.stdout)[1])
        try:
            variant.wheels()
        except FileNotFoundError as error:
            pytest.skip(f"'make wheels' has not run yet: {error}")
        return build_extension.build(
            variant, ROOT / "svrgs_addon" / variant.library, tmp_path_factory.mktemp("dist")
        )

    return built


@pytest.fixture
def any_python_zip(tmp_path):
    """The zip without packages for this platform."""
    if build_extension.builder() is None:
        pytest.skip("bpy is not installed, and with it Blender's builder of extensions")
    variant = platforms.Variant(platforms.this_platform(), "any-python")
    return build_extension.build(variant, ROOT / "svrgs_addon" / variant.library, tmp_path)


@pytest.fixture(scope="module")
def data(tiny, tmp_path_factory) -> Path:
    """tiny/: a dataset and its splat; renders/: what `svrgs render` makes of them; varied/: cameras of other
    shapes; distorted/: a lens with distortion; z_up/, rolled/: the cameras of tiny/ in other directions,
    without photographs; nerfstudio/: tiny/ as transforms.json. NAME.npz: the cameras."""
    import scenes
    from svrgs_addon.cli.main import main as run_svrgs
    from svrgs_addon.files.images import write_image
    from svrgs_addon.views.colmap import read_model
    from transforms_dataset import write_transforms

    folder = tmp_path_factory.mktemp("data")
    (folder / "tiny").symlink_to(tiny.folder)
    assert (
        run_svrgs(["render", str(tiny.splat), "--data", str(tiny.folder), "--out", str(folder / "renders")])
        == 0
    )
    views = [
        replace(scenes.CAMERAS[name], name=f"{name}/{i}.png")
        for i, name in enumerate(("rotated", "off_centre", "outside", "wide", "narrow"))
    ]
    write_colmap(folder / "varied/sparse/0", views, tiny.truth.means)
    for view in views:
        write_image(folder / "varied/images" / view.name, np.full((view.height, view.width, 3), 0.5))
    write_colmap(
        folder / "distorted/sparse/0", tiny.cameras[:2], tiny.truth.means, distortion=(0.1, 0.01, 0.0, 0.0)
    )
    (folder / "distorted/images").symlink_to(tiny.folder / "images")
    write_colmap(
        folder / "z_up/sparse/0",
        [view.moved(turn(np.pi / 2, "x")) for view in tiny.cameras],
        tiny.truth.means,
    )
    (folder / "nerfstudio").mkdir()
    (folder / "nerfstudio/images").symlink_to(tiny.folder / "images")
    write_transforms(folder / "nerfstudio", read_model(tiny.folder / "sparse/0"))
    rolled = [replace(view, viewmat=turn(2.1 * i, "z") @ view.viewmat) for i, view in enumerate(tiny.cameras)]
    write_colmap(folder / "rolled/sparse/0", rolled, tiny.truth.means)
    for name, cameras in {"tiny": tiny.cameras, "varied": sorted(views, key=lambda view: view.name)}.items():
        np.savez(
            folder / f"{name}.npz", viewmats=[c.viewmat for c in cameras], Ks=[c.K for c in cameras],
            sizes=[(c.width, c.height) for c in cameras], names=[c.name for c in cameras],
            points=tiny.truth.means,
        )  # fmt: skip
    return folder


def turn(angle: float, axis: str) -> np.ndarray:
    """(4, 4) rotation about an axis; angle in radians."""
    first, second = {"x": (1, 2), "z": (0, 1)}[axis]
    matrix = np.eye(4)
    matrix[[first, second], [first, second]] = np.cos(angle)
    matrix[second, first], matrix[first, second] = np.sin(angle), -np.sin(angle)
    return matrix


def write_colmap(folder: Path, views: list, points: np.ndarray, distortion: tuple = ()):
    """A binary model in which every view has a camera of its own."""
    import pycolmap

    model = pycolmap.Reconstruction()
    for number, view in enumerate(views, 1):
        params = [view.K[0, 0], view.K[1, 1], view.K[0, 2], view.K[1, 2]]
        kind = "OPENCV" if distortion else "PINHOLE"
        camera = pycolmap.Camera(
            camera_id=number, model=kind, width=view.width, height=view.height, params=[*params, *distortion]
        )
        model.add_camera_with_trivial_rig(camera)
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(view.viewmat[:3, :3]), view.viewmat[:3, 3])
        model.add_image_with_trivial_frame(
            pycolmap.Image(name=view.name, camera_id=number, image_id=number), pose
        )
    for point in points.astype(np.float64):
        model.add_point3D(point, pycolmap.Track(), np.array([200, 150, 100], np.uint8))
    folder.mkdir(parents=True)
    model.write_binary(folder)


def test_the_zip_holds_the_product_and_nothing_else(extension_zip):
    with zipfile.ZipFile(extension_zip(sys.executable, "-c")) as archive:
        names = archive.namelist()
        manifest = tomllib.loads(archive.read("blender_manifest.toml").decode())
        licences = archive.read("LICENSES.txt").decode()
    packages = [wheel.split("/")[-1].split("-")[0] for wheel in manifest["wheels"] if "svrgs" not in wheel]
    assert all(f"{package}-" in licences for package in (*packages, "sphinx", "furo"))
    files, folders = "__init__.py blender_manifest.toml LICENSE LICENSES.txt", "manual operators panels"
    top = {*files.split(), *folders.split(), "svrgs_addon", "wheels"}
    assert {name.split("/")[0] for name in names} == top
    assert "operators/data/splat_object.py" in names and "Spark" in licences
    assert {f"svrgs_addon/viewer/web/modules/{name}.bin" for name in MODULES} <= {*names}
    assert not any(name.endswith((".so", ".dll", ".dylib", ".pyc")) for name in names), "nothing is compiled"
    assert sorted(name for name in names if name.startswith("wheels/")) == sorted(
        wheel[2:] for wheel in manifest["wheels"]
    )
    assert manifest["platforms"] == [platforms.this_platform()]


def test_versions_agree_and_only_files_are_asked_for():
    import svrgs_addon

    assert svrgs_addon.__version__ == platforms.VERSION
    assert f"\nversion: {platforms.VERSION}\n" in (ROOT / "CITATION.cff").read_text()
    assert f"## {platforms.VERSION}" in (ROOT / "CHANGELOG.md").read_text()
    assert list(MANIFEST["permissions"]) == ["files"] and MANIFEST["license"] == ["SPDX:GPL-3.0-or-later"]


def test_the_manifest_follows_the_rules_of_the_public_repository():
    """Those of extensions.blender.org that its builder does not check."""
    assert not re.search("blender", MANIFEST["name"] + MANIFEST["id"], re.IGNORECASE)
    assert len(MANIFEST["tagline"]) <= 64 and MANIFEST["tagline"][-1].isalnum()
    assert all(re.fullmatch(r"\d{4}(-\d{4})? \w.*", holder) for holder in MANIFEST["copyright"])
    reasons = MANIFEST["permissions"].values()
    assert all(len(reason) <= 64 and reason[-1].isalnum() for reason in reasons)
    assert MANIFEST["maintainer"] and MANIFEST["tags"]
    sources = [
        path for folder in ("svrgs_addon", "operators", "panels") for path in (ROOT / folder).rglob("*.py")
    ]
    written = re.compile(r"sys\.path(\.\w+\(|\s*\+?=|\[)")
    assert len(sources) > 200 and not [path for path in sources if written.search(path.read_text("utf-8"))]


def in_folder(words: Iterable[str]) -> list[str]:
    return [str(BLENDER_TESTS / word) if word.endswith(".py") else word for word in words]


def chosen_tests() -> list[list[str]]:
    """The tests of tests/blender in lists for one Blender each; with SVRGS_BLENDER_TESTS, these alone."""
    if words := shlex.split(os.environ.get("SVRGS_BLENDER_TESTS", "")):
        return [in_folder(words)]
    files = sorted(map(str, BLENDER_TESTS.glob("test_*.py")))
    return [files[part::PARTS] for part in range(PARTS)]


@pytest.mark.slow
@pytest.mark.parametrize("chosen", chosen_tests(), ids=lambda _: "part")
@pytest.mark.parametrize("python", PYTHONS)
def test_inside_blender(python, chosen, extension_zip, data, tmp_path):
    run_in_blender(python, extension_zip(python, "-c"), data, tmp_path, chosen)


def test_inside_blender_in_short(extension_zip, data, tmp_path):
    run_in_blender(sys.executable, extension_zip(sys.executable, "-c"), data, tmp_path, in_folder(SHORT))


@pytest.mark.slow
def test_inside_a_blender_without_pycolmap_by_the_zip_without_wheels(any_python_zip, data, tmp_path):
    python = python_without(["pycolmap", "torch"], tmp_path / "python")
    run_in_blender(python, any_python_zip, data, tmp_path, in_folder(["without_pycolmap.py"]))


def python_without(packages: list[str], folder: Path) -> str:
    """A Python that has the packages of this one, but not these. Returns its path."""
    venv.create(folder, symlinks=True)
    there = Path(sysconfig.get_path("purelib", vars={"base": str(folder)}))
    for entry in Path(sysconfig.get_path("purelib")).iterdir():
        if re.split("[-.]", entry.name)[0] not in packages:
            (there / entry.name).symlink_to(entry)
    return str(folder / "bin/python")


def run_in_blender(python: str, extension: Path, data: Path, folder: Path, chosen: list[str]):
    """Runs chosen tests of tests/blender with the bpy of a Python. `folder` becomes the folder of Blender's
    user."""
    environment = {
        **os.environ,
        "SVRGS_TEST_ZIP": str(extension),
        "SVRGS_TEST_DATA": str(data),
        "BLENDER_USER_RESOURCES": str(folder),
        "PYTHONPATH": os.pathsep.join((str(ROOT), str(ROOT / "benchmarks"))),  # generated scenes
    }
    words = "-m pytest -q --durations=8 -p no:cacheprovider -p no:randomly --rootdir".split()
    words += [ROOT / "tests/blender", "-c", os.devnull, *chosen]
    done = subprocess.run(
        [python, *map(str, words)], env=environment, cwd=folder, capture_output=True, text=True, timeout=1200
    )
    assert done.returncode == 0, done.stdout[-8000:] + done.stderr[-2000:]
    print(done.stdout)
