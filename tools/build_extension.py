"""Builds zips of the Blender extension in dist/ and checks them: python tools/build_extension.py [--all]

Without --all: the one for this platform and this Python, with the native core of this checkout. With --all:
every one of platforms.toml, with the native cores that tools/build_wheels.py has built, and a static
repository of them, dist/repository/. Both is done by Blender's own builder, a script inside the bpy package.
It runs without starting Blender.
"""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import sys
import tempfile
import zipfile
from importlib.metadata import distribution
from pathlib import Path

import manual
import native_wheel
from platforms import ROOT, TABLE, Variant, variant_for, variants

DIST = ROOT / "dist"
PRODUCT = ("__init__.py", "LICENSE", "operators", "panels", "svrgs_addon")
LICENCE = re.compile(r"\.dist-info/(licenses/)?(LICEN[CS]E|COPYING|THIRD-PARTY)[^/]*$")
BUILT_HERE = shutil.ignore_patterns("__pycache__", ".*", "*.so", "*.dll", "*.dylib", "*.new")


def builder() -> Path | None:
    """Blender's script that builds extensions, or None where bpy is not installed."""
    spec = importlib.util.find_spec("bpy")
    if spec is None or spec.origin is None:
        return None
    return next(Path(spec.origin).parent.glob("*/scripts/addons_core/bl_pkg/cli/blender_ext.py"))


def manifest(variant: Variant, library: Path) -> str:
    """The manifest of one zip: blender_manifest.toml with the version, the versions of Blender, the platform
    and the wheels."""
    lines = [f'version = "{variant.version}"', f'platforms = ["{variant.platform}"]']
    lines += [
        f'blender_version_{end} = "{variant.facts[end]}"' for end in ("min", "max") if end in variant.facts
    ]
    names = [native_wheel.name_of(library, variant.platform), *(wheel.name for wheel in variant.wheels())]
    lines += ["wheels = [", *(f'  "./wheels/{name}",' for name in names), "]"]
    text = (ROOT / "blender_manifest.toml").read_text(encoding="utf-8")
    return text.replace("\n[permissions]", "\n".join([*lines, "\n[permissions]"]))


def stage(variant: Variant, library: Path, folder: Path) -> None:
    """Fills a new folder with what the zip will hold."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for name in PRODUCT:
        source = ROOT / name
        (
            shutil.copytree(source, folder / name, ignore=BUILT_HERE)
            if source.is_dir()
            else shutil.copy2(source, folder)
        )
    shutil.copytree(manual.build(), folder / "manual")
    native_wheel.write(library, variant.platform, folder / "wheels")
    for wheel in variant.wheels():
        shutil.copy2(wheel, folder / "wheels")
    (folder / "LICENSES.txt").write_text(licences(variant.wheels()), encoding="utf-8")
    (folder / "blender_manifest.toml").write_text(manifest(variant, library), encoding="utf-8")


def licences(wheels: list[Path]) -> str:
    """The licence texts of what the zip holds of others: its wheels, the modules of web pages, and the
    scripts and styles of the manual."""
    web = Path("svrgs_addon/viewer/web/LICENSES.txt")
    texts = [(str(web), (ROOT / web).read_text(encoding="utf-8"))]
    for wheel in wheels:
        with zipfile.ZipFile(wheel) as files:
            texts += [(name, files.read(name).decode()) for name in files.namelist() if LICENCE.search(name)]
    for made_with in ("sphinx", "furo"):
        files = distribution(made_with).files or []
        texts += [(str(file), file.read_text()) for file in files if LICENCE.search(str(file))]
    return "\n\n".join(f"{'=' * 80}\n{name}\n{'=' * 80}\n\n{text}" for name, text in texts)


def build(variant: Variant, library: Path, folder: Path) -> Path:
    """Builds the zip of a variant in `folder` and validates it. Returns its path. Raises RuntimeError with
    what Blender's builder said."""
    made = folder / f"{variant.name}.zip"
    folder.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as temp_dir:
        staged = Path(temp_dir) / variant.name
        stage(variant, library, staged)
        _blender_ext("build", "--source-dir", staged, "--output-filepath", made)
    _blender_ext("validate", made)
    return made


def generate_repository(zips: list[Path], folder: Path) -> None:
    """A folder that a web server can offer to Blender as it is: the zips, index.json, index.html."""
    shutil.rmtree(folder, ignore_errors=True)
    folder.mkdir(parents=True)
    for made in zips:
        (folder / made.name).hardlink_to(made)
    _blender_ext("server-generate", "--repo-dir", folder, "--html")


def in_repository(variant: Variant) -> bool:
    """Whether Blender may choose it by itself: with its packages, or where they have no wheels."""
    return bool(variant.facts["packages"]) or "wheels" not in TABLE["platform"][variant.platform]


def _blender_ext(*words: object) -> None:
    done = subprocess.run(
        [sys.executable, builder(), *map(str, words)], capture_output=True, encoding="utf-8"
    )
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)


def main() -> int:
    if builder() is None:
        print(
            "the extension's builder is part of the Blender module (bpy), which exists for Python 3.11 and"
            " 3.13",
            file=sys.stderr,
        )
        return 1
    for old in DIST.glob("*.zip"):
        old.unlink()
    if "--all" in sys.argv:
        made = {variant: build(variant, variant.built_library, DIST) for variant in variants()}
        generate_repository(
            [path for variant, path in made.items() if in_repository(variant)], DIST / "repository"
        )
    else:
        variant = variant_for(f"cp{sys.version_info[0]}{sys.version_info[1]}")
        made = {variant: build(variant, ROOT / "svrgs_addon" / variant.library, DIST)}
    for path in made.values():
        print(f"{path.stat().st_size / 1e6:6.1f} MB  {path.relative_to(ROOT)}")
    return 0


if __name__ == "__main__":
    sys.exit(main())
