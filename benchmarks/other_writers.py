"""Files of a scene as other programs write them: gaussforge (SPZ, SOG, compressed PLY), gsply (SPZ,
compressed PLY), and splat-transform (SOG, compressed PLY). The first two are packages of PyPI, in
requirements-dev.txt; splat-transform is one of npm, @playcanvas/splat-transform."""

from __future__ import annotations

import shutil
import subprocess
from dataclasses import replace
from pathlib import Path

import numpy as np

from svrgs_addon.files.axes import turned_over
from svrgs_addon.files.registry import write_scene
from svrgs_addon.scene.gaussians import Scene

GAUSSFORGE = {".spz": "spz", ".sog": "sog", ".compressed.ply": "compressed.ply"}


def by_gaussforge(path: Path, scene: Scene):
    """Writes the scene. It takes a PLY, and leaves the axes of an SPZ as they are. Raises RuntimeError."""
    import gaussforge

    suffix = "".join(path.suffixes)
    given = turned_over(scene) if suffix == ".spz" else scene
    ply = path.with_name("given.ply")
    write_scene(ply, replace(given, attributes={}))
    result = gaussforge.GaussForge().convert(ply.read_bytes(), "ply", GAUSSFORGE[suffix])
    if "data" not in result:
        raise RuntimeError(f"{path}: {result}")
    path.write_bytes(result["data"])


def by_gsply(path: Path, scene: Scene):
    """Writes the scene, an SPZ of the version that it usually takes. It leaves the axes as they are."""
    import gsply

    given = turned_over(scene) if path.suffix == ".spz" else scene
    quats = given.quats / np.linalg.norm(given.quats, axis=1, keepdims=True)
    base, higher = (np.ascontiguousarray(part) for part in (given.sh[:, 0], given.sh[:, 1:]))
    data = gsply.GSData.from_arrays(given.means, given.log_scales, quats, given.opacity_logits, base, higher)
    if path.suffix == ".spz":
        gsply.write_spz(path, data)
    else:
        gsply.plywrite(path, data, compressed=True)


def splat_transform() -> str:
    """The program. Raises SystemExit if it is not installed."""
    found = shutil.which("splat-transform")
    if found is None:
        raise SystemExit("splat-transform is not on the PATH: npm install -g @playcanvas/splat-transform")
    return found


def by_splat_transform(path: Path, scene: Scene):
    """Writes the scene, on processors alone. Raises CalledProcessError."""
    ply = path.with_name("given.ply")
    write_scene(ply, replace(scene, attributes={}))
    subprocess.run([splat_transform(), "--overwrite", "--quiet", "--gpu", "cpu", ply, path], check=True)


OTHERS = {
    ("gaussforge", ".spz"): by_gaussforge,
    ("gaussforge", ".sog"): by_gaussforge,
    ("gaussforge", ".compressed.ply"): by_gaussforge,
    ("gsply", ".spz"): by_gsply,
    ("gsply", ".compressed.ply"): by_gsply,
    ("splat-transform", ".sog"): by_splat_transform,
    ("splat-transform", ".compressed.ply"): by_splat_transform,
}


def others() -> list[tuple[str, str]]:
    """Program and suffix of what can be written here."""
    here = shutil.which("splat-transform") is not None
    return [key for key in OTHERS if here or key[0] != "splat-transform"]
