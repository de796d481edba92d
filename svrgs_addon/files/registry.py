"""The registry of splat formats, and reading and writing of splat files in any of them.

Menus, drag and drop, batches and `svrgs info` use this registry. A new format is one module with a
SplatFormat, and its place in FORMATS. The module reads and writes it, and knows its limits (sog_writer.py for
SOG). What holds its values is beside it: *_header.py, *_body.py, *_container.py, *_layout.py. What several
formats share: quantised.py (values in few bits), sh_rounding.py and palette.py (SH), axes.py (y up).
"""

from __future__ import annotations

import contextlib
import logging
import tempfile
from collections.abc import Iterable, Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from ..native.library import thresholds
from ..scene.gaussians import Scene
from ..system import memory
from ..system.errors import FormatError, SceneError, TooMany
from ..system.file_names import extended, real, shown
from . import compressed_ply, dot_splat, glb, glb_spz, ksplat, ply, sog, spz, streamed_sog, usd
from .atomic import checked
from .quantised import far_away
from .reading import MAX_IN_PARTS
from .repair import bake_filter, clamp_extremes, drop_nonfinite, unusable
from .sh_rounding import SeenFrom
from .splat_format import SplatFormat

FORMATS: tuple[SplatFormat, ...] = (  # the first one is that of 3DGS
    ply.FORMAT,
    compressed_ply.FORMAT,
    spz.FORMAT,
    glb_spz.FORMAT,
    glb.FORMAT,
    usd.FORMAT,
    sog.FORMAT,
    streamed_sog.FORMAT,
    dot_splat.FORMAT,
    ksplat.FORMAT,
)
USUAL = spz.FORMAT  # written where no format is named: the least loss for its size (docs/formats.md)
INDEXES = tuple(one.index for one in FORMATS if one.index)
SAMPLE, CHUNKED = 16_384, 256  # Gaussians of which sizes of files are foreseen
SNIFFED_BYTES = 65_536  # bytes at the start of a file that decide between formats with the same suffix


def suffixes(written: bool = False) -> tuple[str, ...]:
    """Suffixes with the dot, of all formats or only of those that can be written."""
    formats = [one for one in FORMATS if one.write or not written]
    return tuple(dict.fromkeys(suffix for one in formats for suffix in one.suffixes))


def menu_label(written: bool = False) -> str:
    """'3D Gaussian Splat (.ply/.spz/...)' for menus, without suffixes that end as another one does. written:
    only formats that can be written."""
    found = suffixes(written)
    ends = [one for one in found if not any(one != other and one.endswith(other) for other in found)]
    return f"{FORMATS[0].label} ({'/'.join(ends)})"


def format_to_write(path: str | Path) -> SplatFormat:
    """The format for writing a file with this name, by its suffix. Raises SceneError if no format has it."""
    name = extended(path).name.lower()
    if indexed := next((one for one in FORMATS if one.index == name), None):
        return indexed
    longest = max(filter(name.endswith, suffixes(written=True)), key=len, default=None)
    if longest is None:
        raise SceneError(f"{path}: scenes are written as {', '.join(suffixes(written=True))}")
    return next(one for one in FORMATS if one.write and longest in one.suffixes)


def format_to_read(path: str | Path) -> SplatFormat:
    """The format of an existing file: by its suffix, and by its first bytes if several formats have this
    suffix. Raises SceneError for a missing file or a folder, FormatError for an unknown suffix."""
    path = extended(path)
    if not path.exists():
        raise SceneError(f"{path}: there is no such file; check the path")
    if found := _indexed(path):
        return found[0]
    if path.is_dir():
        raise SceneError(f"{path}: is a folder, or holds several splats: name the file to use")
    if not path.is_file():  # a pipe would be waited for
        raise SceneError(f"{path}: is a pipe or a device, not a file: copy its contents into a file")
    fitting = [one for one in FORMATS if path.name.lower().endswith(one.suffixes)]
    if not fitting:
        raise FormatError(f"{path}: '{path.suffix}' files are not read; splats are {', '.join(suffixes())}")
    if len(fitting) == 1:  # no need to read its first bytes; the reader reports errors
        return fitting[0]
    with open(path, "rb") as file:
        head = file.read(SNIFFED_BYTES)
    return next((splat_format for splat_format in fitting if splat_format.sniff(head)), fitting[0])


def split_name(path: str | Path) -> tuple[str, str]:
    """The name of a splat file without its suffix, and the suffix: ('scene', '.compressed.ply')."""
    path = Path(path)
    if path.name in INDEXES:
        return path.absolute().parent.name, sog.SUFFIX
    found = max(
        (suffix for suffix in suffixes() if path.name.lower().endswith(suffix)), key=len, default=path.suffix
    )
    return path.name[: len(path.name) - len(found)], path.name[len(path.name) - len(found) :]


def is_splat_folder(path: Path) -> bool:
    """Whether a folder holds one splat of several files, as a SOG: a meta.json with textures beside it."""
    return path.is_dir() and _indexed(path) is not None


def _indexed(path: Path) -> tuple[SplatFormat, Path] | None:
    """The format and the index of a splat of several files. path: the index, or its folder."""
    for one in FORMATS:
        if one.parts and path.name == one.index:
            return one, path
        if one.parts and (path / one.index).is_file() and len(one.parts(path / one.index)) > 1:
            return one, path / one.index
    return None


def _files_of(path: Path) -> list[Path]:
    """The files of a splat, the index of several ones first. path: the file, the index, or its folder."""
    found = _indexed(path)
    return found[0].parts(found[1]) if found and found[0].parts else [path]


def refuse_input(out: Path, path: Path):
    """Raises SceneError if writing `out` would replace the splat `path`, or a file of it. Both may be the
    index of a splat of several files, and the path also the folder of one."""
    replaced = [out, *(_files_of(extended(out)) if out.exists() else ())]
    if real(_files_of(extended(path))[0]) in set(map(real, replaced)):
        raise SceneError(f"{out}: is the input itself, which is never overwritten; choose another output")


def size_on_disk(path: str | Path) -> int:
    """Size of a splat in bytes, with all its files if it has several."""
    return sum(file.stat().st_size for file in _files_of(extended(path)))


def read_scene(path: str | Path) -> Scene:
    """Reads the scene with values as stored. Raises FormatError, or SceneError if the file is missing or
    memory does not suffice."""
    splat_format = format_to_read(path)
    memory.refuse_excess(f"{path}: reading it", memory.reading(size_on_disk(path)), memory.IN_PARTS)
    return splat_format.whole(extended(path))


def read_parts(path: str | Path) -> Iterator[Scene]:
    """As read_scene(), in parts in the order of the file, which may overwrite the arrays of the last."""
    yield from format_to_read(path).read_parts(extended(path), MAX_IN_PARTS)


def check_readable(path: str | Path):
    """Reads the header and at most a few thousand Gaussians. Raises FormatError, SceneError."""
    next(read_parts(path), None)


def load_scene(path: str | Path) -> Scene:
    """Reads a scene and repairs it: bakes the filter of Mip-Splatting, drops Gaussians that are not finite
    and clamps extreme values (repair.py). All is logged. Raises FormatError, or SceneError also if none is
    left."""
    [scene] = _repaired(path, map(read_scene, [path]))
    return scene


def load_parts(path: str | Path) -> Iterator[Scene]:
    """As load_scene(), in parts in the order of the file; each may overwrite the arrays of the previous one.
    What was repaired is logged at the end."""
    return _repaired(path, read_parts(path))


def _repaired(path: str | Path, parts: Iterable[Scene]) -> Iterator[Scene]:
    count = dropped = clamped = 0
    filtered = False
    for part in parts:
        part, baked = bake_filter(part)
        part, bad = drop_nonfinite(part)
        part, extreme = clamp_extremes(part)
        count, dropped, clamped = count + part.count, dropped + bad, clamped + extreme
        filtered = filtered or baked
        yield part
    if filtered:
        logging.warning("%s: the 3D filter of Mip-Splatting was baked into scales and opacities", path)
    if dropped or clamped:
        logging.warning(
            "%s: %d Gaussians with values that are not finite were dropped, %d with extreme values were"
            " clamped",
            path,
            dropped,
            clamped,
        )
    if not count:
        raise SceneError(f"{path}: has no usable Gaussian; export the scene again")


def write_scene(
    path: str | Path,
    scene: Scene,
    version: int = 0,
    quantise: float = 1.0,
    seen: SeenFrom | None = None,
):
    """Writes the scene atomically, in the format of the suffix of `path`. What the format cannot hold is
    logged. version: of the format; 0: that which it chooses. quantise: factor on the error in SH that a
    format may make which chooses it. seen: from where, so that it makes less error there. Raises SceneError;
    also if the file cannot be read again, or, but for a PLY, without a Gaussian."""
    splat_format = format_to_write(path)
    assert splat_format.write is not None
    splat_format.check_packages(Path(path))
    if not scene.count and not splat_format.lossless:
        raise SceneError(f"{path}: there is no Gaussian to write")
    if version and version not in splat_format.versions:
        raise SceneError(f"{path}: the format {splat_format.label} has no version {version}")
    if quantise != 1 and not splat_format.quantises:
        raise SceneError(
            f"{path}: the format {splat_format.label} has no choice of how exactly it stores spherical"
            " harmonics: leave --quantise out"
        )
    choices = ({"version": version} if version else {}) | _rounding(splat_format, quantise, seen)
    target, several = extended(path), extended(path).name == splat_format.index
    check = partial(_check_written, path)
    with contextlib.nullcontext() if several else checked(target, check):
        splat_format.write(target, scene, **choices)
    if several:  # they can be read when all are there
        check(target)
    for sentence in left_out(scene, splat_format):
        logging.warning("%s: %s", path, sentence)


def _rounding(splat_format: SplatFormat, quantise: float, seen: SeenFrom | None) -> dict[str, Any]:
    """What a format is told on how to round."""
    told: dict[str, Any] = {"quantise": quantise} if quantise != 1 else {}
    return told | ({"seen": seen} if seen and splat_format.quantises else {})


def _check_written(path: str | Path, written: Path):
    """Raises SceneError if a file that was just written for `path` cannot be read."""
    try:
        check_readable(written)
    except TooMany:
        return  # memory is short now; the file may be good
    except FormatError as error:
        if isinstance(error.__cause__, TooMany):
            return
        found = str(error).replace(str(written), str(path)).replace(shown(str(written)), str(path))
        raise SceneError(f"{found}: it was written just now, so write another format") from None


def read_back(path: str | Path, scene: Scene) -> Scene:
    """The scene as the file holds it to which it was just written; lossless: itself. Raises FormatError."""
    return scene if format_to_write(path).lossless else read_scene(path)


def round_trip(
    scene: Scene,
    splat_format: SplatFormat,
    quantise: float = 1.0,
    seen: SeenFrom | None = None,
    suffix: str = "",
) -> tuple[Scene, int]:
    """The scene as a file of the format would hold it, and the size in bytes. quantise, seen: as of
    write_scene(). suffix: of the file; "": the first one of the format. Raises SceneError, FormatError."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / (splat_format.index or f"scene{suffix or splat_format.suffixes[0]}")
        assert splat_format.write is not None
        splat_format.write(path, scene, **_rounding(splat_format, quantise, seen))
        return splat_format.whole(path), size_on_disk(path)


def left_out(scene: Scene, splat_format: SplatFormat) -> list[str]:
    """A sentence on each thing of the scene that the format cannot hold, or that is beyond its limits."""
    sentences, columns = [], [name for name in scene.attributes if name not in ply.NORMALS]
    if columns and "attributes" not in splat_format.carries:
        sentences.append(
            f"the format {splat_format.label} cannot hold further columns; left out: {', '.join(columns)}"
        )
    sentences += higher_bands(scene, splat_format)
    if scene.antialiased and "antialiased" not in splat_format.carries:
        sentences.append(
            f"the format {splat_format.label} cannot say that the scene is antialiased, so programs will draw"
            " small Gaussians too thick"
        )
    limits = splat_format.limits(scene) if splat_format.limits else []
    coarse = far_away(scene) if not any("positions" in sentence for sentence in limits) else []
    return [*sentences, *limits, *coarse]


def higher_bands(scene: Scene, splat_format: SplatFormat) -> list[str]:
    """A sentence if the format cannot hold all SH of the scene."""
    if scene.sh_degree <= splat_format.most_degree:
        return []
    return [
        f"the format {splat_format.label} holds spherical harmonics up to degree {splat_format.most_degree},"
        " so higher ones are left out"
    ]


def foreseen_size(one: Scene, count: int, splat_format: SplatFormat = FORMATS[0]) -> int | None:
    """Size in bytes of a scene of `count` Gaussians with the columns of `one`, which has one Gaussian. Right
    but for the digits of the count and the end of the last chunk. None if it depends on the values."""
    if splat_format.size is None:
        return None
    header = splat_format.size(one.select(np.arange(0)))
    return header + count * (splat_format.size(one.select(np.zeros(CHUNKED, int))) - header) // CHUNKED


def sampled_size(scene: Scene, splat_format: SplatFormat, quantise: float = 1.0) -> int:
    """Size in bytes of the file that the format would make, by that of a part of the scene: Gaussians that
    lie together. Within a fifth. Raises SceneError, FormatError."""
    around = np.arange(scene.count)
    if scene.count > SAMPLE:
        around = np.argsort(np.abs(scene.means - np.median(scene.means, axis=0)).max(axis=1))[:SAMPLE]
    return round_trip(scene.select(around), splat_format, quantise)[1] * scene.count // max(1, len(around))


def invisible(scene: Scene) -> np.ndarray:
    """(N,) bool: Gaussians that no pixel shows, with an opacity below the alpha cut (1/255)."""
    return too_faint(scene.opacity_logits)


def too_faint(opacity_logits: np.ndarray) -> np.ndarray:
    """As invisible(), of the logits alone."""
    cut = thresholds().alpha_cut
    return opacity_logits < np.float32(np.log(cut / (1 - cut)))


def describe(path: str | Path) -> dict:
    """Summary of a splat file; reads a few thousand Gaussians at a time. Raises FormatError, SceneError.

    Keys: count, sh_degree, format, bytes (size of the file), invisible (number of usable Gaussians with an
    opacity below 1/255), nonfinite (number of unusable Gaussians), antialiased, bounds ([min xyz, max xyz] of
    the means, or None), attributes (names).
    """
    count = faint = bad = 0
    corners = []
    splat_format = format_to_read(path)
    for part in read_parts(path):
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
        "bytes": size_on_disk(path),
        "invisible": faint,
        "nonfinite": bad,
        "antialiased": part.antialiased,
        "bounds": [np.min(corners, axis=0).tolist(), np.max(corners, axis=0).tolist()] if corners else None,
        "attributes": sorted(part.attributes),
    }
