"""Splat files by their suffix, with what reading had to mend."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import memory
from ..errors import FormatError, SceneError
from ..scene import Scene
from .ply import read_ply, read_ply_parts, write_ply
from .repair import clamp_extremes, drop_nonfinite, unusable

INVISIBLE_LOGIT = float(np.log(1 / 254))  # opacity 1/255: fainter Gaussians reach no pixel in any view


@dataclass(frozen=True)
class Loaded:
    """A scene fit for rendering, and how many Gaussians were dropped or mended to make it so."""

    scene: Scene
    dropped: int
    clamped: int


def read_scene(path: str | Path) -> Scene:
    """The scene as it lies in the file. Raises FormatError; SceneError too where memory would not hold it."""
    path = _splat_file(path)
    memory.refuse_excess(f"{path}: reading it", memory.reading(path.stat().st_size))
    return read_ply(path)


def _splat_file(path: str | Path) -> Path:
    """`path`, if it looks like a file that can be read."""
    path = Path(path)
    if not path.exists():
        raise SceneError(f"{path}: there is no such file")
    if path.is_dir():
        raise SceneError(f"{path}: is a folder, or holds several splats: name the .ply to use")
    if path.suffix.lower() != ".ply":
        raise FormatError(f"{path}: '{path.suffix}' files are not read; give a 3DGS .ply")
    return path


def load_scene(path: str | Path) -> Loaded:
    """read_scene, without Gaussians that are not finite and with extreme values clamped; both are logged."""
    scene, dropped = drop_nonfinite(read_scene(path))
    scene, clamped = clamp_extremes(scene)
    if dropped or clamped:
        logging.warning("%s: %d Gaussians with values that are not finite were dropped, %d with extreme values were clamped", path, dropped, clamped)
    if not scene.count:
        raise SceneError(f"{path}: has no usable Gaussian")
    return Loaded(scene, dropped, clamped)


def write_scene(path: str | Path, scene: Scene):
    write_ply(path, scene)


def invisible(scene: Scene) -> np.ndarray:
    """(N,) bool: too faint to reach any pixel, opacity < 1/255."""
    return scene.opacity_logits < INVISIBLE_LOGIT


def describe(path: str | Path) -> dict:
    """What is in a file: keys count, sh_degree, format, bytes, invisible, nonfinite, antialiased, bounds, attributes.

    Never holds more than a few thousand of its Gaussians.
    """
    count = faint = bad = 0
    corners = []
    for part in read_ply_parts(_splat_file(path)):
        good = ~unusable(part)
        means = np.ascontiguousarray(part.means[good].T)
        if means.size:
            corners += [means.min(axis=1), means.max(axis=1)]
        count += part.count
        bad += part.count - means.shape[1]
        faint += int((invisible(part) & good).sum())
    return {
        "count": count,
        "sh_degree": part.sh_degree,
        "format": "ply",
        "bytes": Path(path).stat().st_size,
        "invisible": faint,
        "nonfinite": bad,
        "antialiased": part.antialiased,
        "bounds": [np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()] if corners else None,
        "attributes": sorted(part.attributes),
    }
