"""Splat files of every format. Menus, drag and drop, batches, `svrgs info` and the readers ask this registry.

A new format is a module with a SplatFormat and one line in FORMATS.
"""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from .. import memory
from ..errors import FormatError, SceneError
from ..native_library import thresholds
from ..scene import Scene
from . import ply
from .repair import clamp_extremes, drop_nonfinite, unusable
from .splat_format import SplatFormat

FORMATS: tuple[SplatFormat, ...] = (ply.FORMAT,)  # the first is the one that is written where none is named
SNIFFED_BYTES = 512


@dataclass(frozen=True)
class Loaded:
    """A scene fit for rendering, and how many Gaussians were dropped or mended to make it so."""

    scene: Scene
    dropped: int
    clamped: int


def suffixes(written: bool = False) -> tuple[str, ...]:
    """The suffixes of all formats, or of those that can be written, with the dot."""
    return tuple(suffix for splat_format in FORMATS if splat_format.write or not written for suffix in splat_format.suffixes)


def labels(written: bool = False) -> tuple[str, ...]:
    """What menus call the formats: 'LABEL (.suffix)'."""
    return tuple(f"{found.label} ({'/'.join(found.suffixes)})" for found in FORMATS if found.write or not written)


def format_to_write(path: str | Path) -> SplatFormat:
    """The format that a file of this name is written in. Raises SceneError."""
    for splat_format in FORMATS:
        if splat_format.write and _ends_with(Path(path), splat_format):
            return splat_format
    raise SceneError(f"{path}: scenes are written as {' or '.join(suffixes(written=True))}")


def format_to_read(path: str | Path) -> SplatFormat:
    """The format of a file: by its suffix, and where several share it by its first bytes. Raises FormatError, SceneError."""
    path = Path(path)
    if not path.exists():
        raise SceneError(f"{path}: there is no such file")
    if path.is_dir():
        raise SceneError(f"{path}: is a folder, or holds several splats: name the {' or '.join(suffixes())} to use")
    fitting = [splat_format for splat_format in FORMATS if _ends_with(path, splat_format)]
    if not fitting:
        raise FormatError(f"{path}: '{path.suffix}' files are not read; give a 3DGS {' or '.join(suffixes())}")
    if len(fitting) == 1:  # its reader says what is wrong with the file
        return fitting[0]
    with open(path, "rb") as file:
        head = file.read(SNIFFED_BYTES)
    return next((splat_format for splat_format in fitting if splat_format.sniff(head)), fitting[0])


def _ends_with(path: Path, splat_format: SplatFormat) -> bool:
    return path.name.lower().endswith(splat_format.suffixes)


def read_scene(path: str | Path) -> Scene:
    """The scene as stored in the file. Raises FormatError; SceneError too where memory would not hold it."""
    splat_format = format_to_read(path)
    memory.refuse_excess(f"{path}: reading it", memory.reading(Path(path).stat().st_size))
    return splat_format.read(Path(path))


def check_readable(path: str | Path):
    """Reads the header and a few thousand Gaussians at most. Raises FormatError, SceneError."""
    next(format_to_read(path).read_parts(Path(path)))


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
    """Writes the scene atomically, in the format of the suffix. Raises SceneError."""
    write = format_to_write(path).write
    assert write is not None
    write(Path(path), scene)


def file_size(scene: Scene) -> int:
    """Bytes of the scene in the first format."""
    size = FORMATS[0].size
    assert size is not None
    return size(scene)


def invisible(scene: Scene) -> np.ndarray:
    """(N,) bool: opacity below the rasterizer's alpha cut, so that no pixel shows the Gaussian."""
    cut = thresholds().alpha_cut
    return scene.opacity_logits < np.float32(np.log(cut / (1 - cut)))


def describe(path: str | Path) -> dict:
    """What is in a file: keys count, sh_degree, format, bytes, invisible, nonfinite, antialiased, bounds, attributes.

    Never holds more than a few thousand of its Gaussians.
    """
    count = faint = bad = 0
    corners = []
    splat_format = format_to_read(path)
    for part in splat_format.read_parts(Path(path)):
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
        "format": splat_format.name,
        "bytes": Path(path).stat().st_size,
        "invisible": faint,
        "nonfinite": bad,
        "antialiased": part.antialiased,
        "bounds": [np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()] if corners else None,
        "attributes": sorted(part.attributes),
    }
