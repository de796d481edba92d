"""Reads SOG version 2 (sog_layout.py), and its place among the formats."""

from __future__ import annotations

import contextlib
import lzma
import os
import tempfile
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..system.errors import FormatError
from ..system.foreign import inside
from . import images
from . import sog_layout as layout
from .images import read_texture
from .quantised import logits_of, quats_of_three
from .reading import BROKEN, MAX_COUNT, is_whole, json_object, open_splat, refuse_unpacking
from .sog_layout import META, SUFFIX, VERSION
from .sog_writer import limits, write
from .splat_format import SplatFormat, by_parts

# most bytes of a file in a bundle: of any, and for each Gaussian; a texture that is not packed has 4
ALWAYS, OF_GAUSSIAN = 1 << 24, 8
MANY = 1 << 16  # pixels that any texture may have
FLOAT_MAX = float(np.finfo(np.float32).max)
# what zipfile raises, also for a password
DAMAGED = (
    *(zipfile.BadZipFile, zlib.error, lzma.LZMAError),
    *(NotImplementedError, RuntimeError, EOFError, ValueError),
)


@dataclass(frozen=True)
class _Sog:
    """A checked meta.json and its textures, (count, 4) uint8 each; those of the palette as images."""

    count: int
    degree: int
    antialiased: bool
    ranges: np.ndarray  # (2, 3) of positions
    tables: dict[str, np.ndarray]
    textures: dict[str, np.ndarray]


def parts(meta: Path) -> list[Path]:
    """The files that a SOG in a folder may have: also one that is damaged is a SOG by them, but a dataset
    with a meta.json is none."""
    return [meta, *sorted(meta.parent.glob("*.webp"))]


def degree_of(meta: Path) -> int:
    """The SH degree of a SOG in a folder, by its meta.json alone. Raises FormatError, which names the
    file."""
    with open_splat(meta):
        return _degree(_meta(meta))


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians in the order of the pixels, in parts. path: folder, its meta.json, or bundle. Raises
    FormatError, which names the file."""
    path = Path(path)
    file = path / META if path.is_dir() else path
    with open_splat(file), _folder(file) as folder:
        sog = _read(folder, max_count)
    yield from by_parts(lambda rows: _scene(sog, rows), sog.count)


@contextlib.contextmanager
def _folder(file: Path) -> Iterator[Path]:
    """The folder with meta.json: that of the file, or one into which a bundle is unpacked. Raises FormatError
    (without the name of the file), as the functions below."""
    if file.name == META:
        yield file.parent
        return
    with tempfile.TemporaryDirectory() as folder:
        _unpack(file, Path(folder))
        yield Path(folder)


def _unpack(file: Path, folder: Path):
    """Writes meta.json of a bundle and the textures that it names into the folder, and no other files."""
    try:
        with zipfile.ZipFile(file) as bundle:
            members = {one.filename: one for one in bundle.infolist()}
            if META not in members or members[META].file_size > layout.MAX_META:
                return  # _meta() says so
            bundle.extract(members[META], folder)
            meta = _meta(folder / META)
            count = meta.get("count")
            most = max(ALWAYS, OF_GAUSSIAN * count) if isinstance(count, int) else ALWAYS
            for name in (name for name in layout.named_in(meta) if name in members):
                if members[name].file_size > most:
                    raise FormatError(f"has a texture {name} that is larger than it can be{BROKEN}")
                bundle.extract(members[name], folder)
    except DAMAGED as error:
        raise FormatError(f"is no SOG, or damaged ({error}); copy or export it again") from None


def _read(folder: Path, max_count: int) -> _Sog:
    meta = _meta(folder / META)
    version, count = meta.get("version"), meta.get("count")
    if version != VERSION:
        raise FormatError(
            f"is a SOG of version {version if isinstance(version, int) else 'unknown'}; version {VERSION} is"
            " read"
        )
    if not is_whole(count):
        raise FormatError(f"names no number of Gaussians{BROKEN}")
    degree = _degree(meta)
    refuse_unpacking(count, SH_COEFFICIENTS[degree], max_count)
    ranges = np.array([_numbers(_part(meta, "means"), name, 3) for name in ("mins", "maxs")])
    parts = ("scales", "sh0", "shN") if degree else ("scales", "sh0")
    tables = {name: _numbers(_part(meta, name), "codebook", layout.TABLE) for name in parts}
    textures = {name: _texture(folder, _part(meta, part), number, count) for name, part, number in _TEXTURES}
    if degree:
        textures["labels"] = _texture(folder, _part(meta, "shN"), 1, count)
        textures["palette"] = _palette(folder, _part(meta, "shN"), SH_COEFFICIENTS[degree] - 1)
    return _Sog(count, degree, meta.get("antialias") is True, ranges, tables, textures)


# name, part, file of it
_TEXTURES = (
    ("low", "means", 0),
    ("high", "means", 1),
    ("scales", "scales", 0),
    ("quats", "quats", 0),
    ("sh0", "sh0", 0),
)


def _meta(path: Path) -> dict[str, Any]:
    if not path.is_file():
        raise FormatError(f"has no {META}, so it is no SOG")
    meta = json_object(path, layout.MAX_META)
    if meta is None:
        raise FormatError(f"has no {META} of at most {layout.MAX_META:,} bytes that can be read{BROKEN}")
    return meta


def _degree(meta: dict[str, Any]) -> int:
    degree = _part(meta, "shN").get("bands") if "shN" in meta else 0
    if not isinstance(degree, int) or degree not in range(len(SH_COEFFICIENTS)):
        raise FormatError(f"has no valid number of SH bands{BROKEN}")
    return degree


def _part(meta: dict[str, Any], name: str) -> dict[str, Any]:
    found = meta.get(name)
    if not isinstance(found, dict):
        raise FormatError(f"has no {name} in its {META}{BROKEN}")
    return found


def _numbers(part: dict[str, Any], name: str, count: int) -> np.ndarray:
    """(count,) float32 finite numbers of meta.json."""
    found = part.get(name)
    valid = lambda one: isinstance(one, int | float) and abs(one) <= FLOAT_MAX
    if not isinstance(found, list) or len(found) != count or not all(map(valid, found)):
        raise FormatError(f"has no {name} of {count} numbers in its {META}{BROKEN}")
    return np.array(found, np.float32)


def _texture(folder: Path, part: dict[str, Any], number: int, count: int) -> np.ndarray:
    """The first `count` pixels of a texture, (count, 4) uint8."""
    pixels = _image(_file(folder, part, number), max(MANY, 2 * count)).reshape(-1, 4)
    if len(pixels) < count:
        raise FormatError(f"has a texture of {len(pixels):,} pixels for {count:,} Gaussians{BROKEN}")
    return pixels[:count]


def _palette(folder: Path, part: dict[str, Any], coefficients: int) -> np.ndarray:
    """(entries, coefficients, 3) uint8."""
    image = _image(_file(folder, part, 0), coefficients * (MANY + layout.PALETTE_ROW))
    if image.shape[1] != layout.PALETTE_ROW * coefficients:
        raise FormatError(
            f"has a palette of SH that is {image.shape[1]} pixels wide, not"
            f" {layout.PALETTE_ROW * coefficients}{BROKEN}"
        )
    return image[:, :, :3].reshape(-1, coefficients, 3)


def _image(file: Path, most: int) -> np.ndarray:
    """A texture of at most so many pixels, (H, W, 4) uint8."""
    if reason := images.lack():
        raise FormatError(f"cannot be read, {reason}")
    try:
        return read_texture(file, most)
    except FormatError as error:
        raise FormatError(
            f"is damaged: its texture {file.name} {str(error).removeprefix(f'{file}: ')}"
        ) from None


def _file(folder: Path, part: dict[str, Any], number: int) -> Path:
    """A file that meta.json names, in the folder itself."""
    names = part.get("files")
    name = names[number] if isinstance(names, list) and len(names) > number else None
    if not isinstance(name, str) or not layout.is_texture(name):
        raise FormatError(f"names no texture next to its {META}{BROKEN}")
    path = inside(folder, name)
    if not path.is_file():
        raise FormatError(f"is incomplete: {name} is missing; copy or export it again")
    return path


def _scene(sog: _Sog, rows: slice) -> Scene:
    """The Gaussians of some pixels."""
    pixels = {name: texture[rows] for name, texture in sog.textures.items() if name != "palette"}
    shares = (pixels["low"][:, :3] + 256.0 * pixels["high"][:, :3]) / layout.HIGHEST
    stored = sog.ranges[0] + shares * (sog.ranges[1] - sog.ranges[0])
    with np.errstate(over="ignore"):  # ranges of a damaged file
        means = (np.sign(stored) * np.expm1(np.abs(stored))).astype(np.float32)
    three = (pixels["quats"][:, :3].astype(np.float32) / 255 - np.float32(0.5)) * layout.ROOT2
    largest = pixels["quats"][:, 3].astype(np.int64) - layout.LARGEST_QUAT
    quats = quats_of_three(three, np.maximum(largest, 0))
    quats[largest < 0] = (1, 0, 0, 0)
    sh = np.zeros((len(means), SH_COEFFICIENTS[sog.degree], 3), np.float32)
    sh[:, 0] = sog.tables["sh0"][pixels["sh0"][:, :3]]
    if sog.degree:
        labels = pixels["labels"][:, 0].astype(np.int64) + 256 * pixels["labels"][:, 1].astype(np.int64)
        known = labels < len(sog.textures["palette"])
        sh[known, 1:] = sog.tables["shN"][sog.textures["palette"][labels[known]]]
    logits = logits_of(pixels["sh0"][:, 3])
    return Scene(
        means, sog.tables["scales"][pixels["scales"][:, :3]], quats, logits, sh, antialiased=sog.antialiased
    )


FORMAT = SplatFormat(
    name="sog",
    label="SOG",
    suffixes=(SUFFIX,),
    sniff=lambda head: head.startswith(b"PK"),
    read_parts=read_parts,
    write=write,
    quantises=True,
    limits=limits,
    index=META,
    parts=parts,
    carries=("antialiased",),
    needs=images.lack,
)
