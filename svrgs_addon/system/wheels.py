"""The packages that the product needs, and where they lie.

Blender unpacks the wheels of an enabled extension into a folder on its sys.path. A checkout, and an extension
that is not enabled, have only the wheels, in wheels/. Compiled modules cannot be imported from a wheel. So
the wheels that fit this Python are unpacked, once, into the user's cache folder.
"""

from __future__ import annotations

import contextlib
import importlib.util
import os
import platform
import shutil
import sys
import tempfile
import time
import zipfile
import zlib
from collections.abc import Iterable
from pathlib import Path

from . import here, replacing
from .errors import SceneError

PACKAGES = ("numpy", "OpenImageIO", "pycolmap")
NATIVE = "svrgs_native"  # the package of the native library, where it comes as a wheel
ROOT = Path(__file__).resolve().parents[2]  # the checkout, or the installed extension
UNFINISHED = ".unpack-"  # begins the names of folders in the cache that are being filled


def importable() -> dict[str, Path]:
    """{package: its folder on sys.path} of those PACKAGES, and of NATIVE, that this process can import."""
    specs = {name: importlib.util.find_spec(name) for name in (*PACKAGES, NATIVE)}
    return {
        name: Path(next(iter(spec.submodule_search_locations))).parent
        for name, spec in specs.items()
        if spec and spec.submodule_search_locations
    }


def find(folders: Iterable[Path] = (), extensions: Iterable[Path] = ()) -> dict[str, Path]:
    """{package: folder to import it from} of those PACKAGES, and of NATIVE, that are found. missing() says
    what to do about the others.

    They are looked for on sys.path, then in `folders`, then among the wheels of ROOT, then among those of
    `extensions`, which are folders of installed extensions. Raises SceneError if numpy is found nowhere, and
    if a wheel cannot be unpacked.
    """
    found = importable()
    for folder in folders:
        found |= {name: folder for name in PACKAGES if name not in found and (folder / name).is_dir()}
    this_python = f"cp{sys.version_info[0]}{sys.version_info[1]}"
    for wheel in _wheels(extensions):
        name = _package(wheel)
        if name and name not in found and _fits_platform(wheel) and _python(wheel) in (this_python, "py3"):
            found[name] = _unpacked(wheel)
    if "numpy" not in found:
        raise SceneError(missing(found, extensions))
    return found


def missing(found: Iterable[str], extensions: Iterable[Path] = ()) -> str:
    """Which of the PACKAGES this Python lacks, and what to do: a sentence; '' if all are in `found`."""
    lacking = [name for name in PACKAGES if name not in found]
    wheels = [wheel for wheel in _wheels(extensions) if _package(wheel) != NATIVE]
    return _what_to_do(lacking, wheels) if lacking else ""


def _wheels(extensions: Iterable[Path]) -> list[Path]:
    return [wheel for root in (ROOT, *extensions) for wheel in sorted((root / "wheels").glob("*.whl"))]


# --- names of wheels: NAME-VERSION-PYTHON-ABI-PLATFORM[.PLATFORM].whl


def _package(wheel: Path) -> str | None:
    name = wheel.name.partition("-")[0]
    return next((one for one in (*PACKAGES, NATIVE) if one.lower() == name.lower()), None)


def _python(wheel: Path) -> str:
    """The tag of the Python it is for, such as cp311."""
    return wheel.stem.rsplit("-", 3)[1]


def _fits_platform(wheel: Path) -> bool:
    """The version of the C library is not compared: Blender needs at least as new a one."""
    tags = wheel.stem.rsplit("-", 1)[1].split(".")
    return any(tag.startswith(here.WHEEL) and tag.endswith(f"_{platform.machine().lower()}") for tag in tags)


def _what_to_do(lacking: list[str], wheels: list[Path]) -> str:
    python = f"Python {sys.version_info[0]}.{sys.version_info[1]} ({sys.executable})"
    lacks = f"{python} lacks {' and '.join(lacking)}"
    install = f"{sys.executable} -m pip install {' '.join(lacking)}"
    if "numpy" in lacking:
        return (
            f"{lacks}: a Blender that uses the system's Python needs the system's numpy too, on Debian the"
            " package python3-numpy"
        )
    if not wheels and (ROOT / "Makefile").exists():
        return (
            f"{lacks}: run 'make wheels' in {ROOT}, or install the extension in this Blender, or run"
            f" {install}"
        )
    if not wheels and (ROOT / "blender_manifest.toml").exists():
        return (
            f"{lacks}: use a Blender with a Python for which there is a zip with packages, or run {install}"
        )
    if not wheels:
        return f"{lacks}: run {install}"
    fitting = [wheel for wheel in wheels if _fits_platform(wheel)]
    pythons = set.intersection(
        *({_python(wheel) for wheel in fitting if _package(wheel) == name} for name in lacking)
    )
    if not pythons:
        return (
            f"{lacks}, and the wheels in {wheels[0].parent} are not for {platform.system()}"
            f" {platform.machine()}: run {install}"
        )
    versions = ", ".join(f"{tag[2]}.{tag[3:]}" for tag in sorted(pythons, key=lambda tag: int(tag[3:])))
    return (
        f"{lacks}, and the wheels in {wheels[0].parent} are for Python {versions}: use a Blender with one of"
        f" these, or run {install}"
    )


# --- the cache


def cache_folder() -> Path:
    """This product's folder in the user's cache; it can be deleted. Raises SceneError without a home."""
    try:
        return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "svrgs"
    except RuntimeError:
        raise SceneError(
            "there is no home folder to unpack the packages in: set XDG_CACHE_HOME to a folder"
        ) from None


def _unpacked(wheel: Path) -> Path:
    """The folder in the cache that holds the files of the wheel. It is filled under another name and then
    renamed. Raises SceneError if the wheel is damaged or the folder cannot be written."""
    folder = cache_folder() / wheel.stem
    if folder.is_dir():
        return folder
    try:
        folder.parent.mkdir(parents=True, exist_ok=True)
        _remove_abandoned(folder.parent)
        with tempfile.TemporaryDirectory(prefix=UNFINISHED, dir=folder.parent) as temp_dir:
            with zipfile.ZipFile(wheel) as archive:
                archive.extractall(Path(temp_dir) / wheel.stem)
            if not folder.is_dir():
                _rename(Path(temp_dir) / wheel.stem, folder)
    except (zipfile.BadZipFile, zlib.error, EOFError) as error:
        raise SceneError(
            f"{wheel}: is damaged ({error}); delete it and run 'make wheels', or install the extension again"
        ) from error
    except OSError as error:
        raise SceneError(
            f"{wheel}: cannot be unpacked into {folder} ({error.strerror or error}); set XDG_CACHE_HOME to"
            " another folder"
        ) from error
    return folder


def _remove_abandoned(cache: Path):
    """Removes what a killed process has not finished. One that still runs needs seconds, not an hour."""
    for folder in cache.glob(f"{UNFINISHED}*"):
        with contextlib.suppress(OSError):  # its process has just finished it
            if time.time() - folder.stat().st_mtime > 3600:
                shutil.rmtree(folder)


def _rename(made: Path, folder: Path):
    try:
        replacing.patiently(lambda: made.rename(folder))  # a virus scanner reads what was just unpacked
    except OSError:
        if not folder.is_dir():  # else another process was quicker, with the same files
            raise
