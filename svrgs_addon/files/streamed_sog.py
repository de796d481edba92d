"""Streamed SOG (PlayCanvas): lod-meta.json beside folders with a SOG each (sog_layout.py), which viewers load
as they need them.

    counts, lodLevels    Gaussians of each level of detail, the finest one first; the number of levels
    filenames            meta.json of each SOG: L_n/meta.json holds Gaussians of level L
    tree                 boxes: `bound` with min and max, and two `children`, or the `lods` of a leaf: by
                         level, `file`, `offset` and `count` of its Gaussians
    environment          meta.json of Gaussians that belong to every level; is read, not written
"""

from __future__ import annotations

import contextlib
import os
import re
import secrets
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

from .. import __version__
from ..scene.gaussians import SH_COEFFICIENTS, Scene
from ..scene.morton_order import morton_order
from ..scene.rotations import rotation_matrices
from ..system.errors import FormatError
from ..system.foreign import inside, own
from . import images, sog
from .atomic import check_space, write_json
from .reading import BROKEN, MAX_COUNT, MAX_IN_PARTS, is_whole, json_object, open_splat, refuse_many
from .sh_rounding import SeenFrom
from .sog_layout import META, files_of
from .sog_writer import BYTES, limits, write_in_order
from .splat_format import SplatFormat

INDEX, VERSION, MAX_LEVELS = "lod-meta.json", 1, 1000
MAX_INDEX = 50_000_000  # bytes of lod-meta.json
CHUNK = 512 * 1024  # Gaussians of a leaf, of all levels together, and of a file, about
# a leaf is not larger, in units of the scene, unless it has no more Gaussians than this
MAX_EXTENT, FEW_GAUSSIANS = 16.0, 8192
UNIT = re.compile(r"[\w-][\w.-]*/meta\.json")
OWN_UNIT = re.compile(r"[0-9]+_[0-9]+(\.[0-9a-f]{8})?/meta\.json")  # names as _Cut gives them
DIGITS = 7  # of the numbers of a box


def read_parts(path: str | os.PathLike, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The finest level, in parts. path: lod-meta.json, or its folder. Raises FormatError, with its name."""
    path = Path(path)
    return read_level(path / INDEX if path.is_dir() else path, 0, max_count)


def read_level(path: Path, level: int, max_count: int = MAX_COUNT) -> Iterator[Scene]:
    """The Gaussians of a level of detail, in parts. Raises FormatError, which names the file."""
    with open_splat(path):
        units = _units_of(_checked(path), level, max_count)
        files = [inside(path.parent, name) for name in units]
    most, left = max(map(sog.degree_of, files), default=0), max_count
    for file in files:
        for part in sog.read_parts(file, left):
            left -= part.count
            yield _with_degree(part, most)
    if not files:
        raise FormatError(f"{path} has no file of level {level}{BROKEN}")


def parts(path: Path) -> list[Path]:
    """The files of all levels that are there; lod-meta.json alone, if it is damaged."""
    try:
        with open_splat(path):
            meta = _checked(path)
    except FormatError:
        return [path]
    units = [path.parent / name for name in dict.fromkeys(_names(meta))]
    return [path, *(file for unit in units if unit.is_file() for file in files_of(unit))]


def level_bytes(path: Path, level: int) -> int:
    """Bytes of the files with Gaussians of the level. Raises FormatError, which names the file."""
    with open_splat(path):
        units = _units_of(_checked(path), level, MAX_IN_PARTS)
    return sum(file.stat().st_size for unit in units for file in files_of(path.parent / unit))


def write(path: str | os.PathLike, scene: Scene, quantise: float = 1.0, seen: SeenFrom | None = None):
    """Writes the scene as the only level of detail. Raises SceneError."""
    write_levels(path, [scene], quantise, [seen])


def write_levels(
    path: str | os.PathLike,
    scenes: Sequence[Scene],
    quantise: float = 1.0,
    seen: Sequence[SeenFrom | None] = (),
):
    """Writes levels of detail, the finest one first: the SOGs, then lod-meta.json. Until then, an older one
    and its files stay as they are; at the end, those of its files are removed that have names as they are
    given here. quantise, seen (of each level, or empty): as of a SOG. Raises SceneError."""
    path = Path(path)
    check_space(path, BYTES * sum(scene.count for scene in scenes))
    old, taken = _own_files(path), path.exists() or any(path.parent.glob("[0-9]*_[0-9]*"))
    cut = _Cut(scenes, f".{secrets.token_hex(4)}" if taken else "")
    tree = cut.node([np.arange(scene.count) for scene in scenes])
    counts = [scene.count for scene in scenes]
    meta = {
        "version": VERSION,
        "asset": {"generator": f"SVR-GS {__version__}"},
        "count": sum(counts),
        "counts": counts,
        "lodLevels": len(scenes),
    }
    for name, (level, rows) in cut.files.items():
        some, view = np.concatenate(rows), seen[level] if seen else None
        write_in_order(
            path.parent / name, scenes[level].select(some), quantise, view.select(some) if view else None
        )
    write_json(path, meta | {"filenames": list(cut.files), "tree": tree})
    for one in old:
        one.unlink(missing_ok=True)
    for folder in {one.parent for one in old}:
        with contextlib.suppress(OSError):  # it holds files of others
            folder.rmdir()


def _own_files(path: Path) -> list[Path]:
    """The files of the SOGs that an older lod-meta.json names, in folders that this program or one like it
    has made for it: none of others, and none through links."""
    try:
        meta = _checked(path)
    except (FormatError, OSError):
        return []
    found = []
    for name in filter(OWN_UNIT.fullmatch, dict.fromkeys(meta["filenames"])):
        with contextlib.suppress(FormatError):
            unit = own(path.parent, *name.split("/"))
            found += files_of(unit) if unit.is_file() else []
    return found


@dataclass
class _Cut:
    """Levels of detail that are being cut into leaves, and the files that their Gaussians go to."""

    scenes: Sequence[Scene]
    tag: str  # in the names of the folders
    # by name: level, and rows of it, leaf by leaf
    files: dict[str, tuple[int, list[np.ndarray]]] = field(default_factory=dict)

    def node(self, rows: list[np.ndarray]) -> dict[str, Any]:
        """The node of lod-meta.json with these rows of each level."""
        means = np.concatenate([scene.means[some] for scene, some in zip(self.scenes, rows, strict=True)])
        sides = np.ptp(means, axis=0) if len(means) else np.zeros(3)
        axis, largest = int(np.argmax(sides)), float(sides.max())
        small = largest <= MAX_EXTENT or len(means) <= FEW_GAUSSIANS
        if not largest > 0 or (len(means) <= CHUNK and small):
            return self.leaf(rows)
        middle = np.partition(means[:, axis], len(means) // 2)[len(means) // 2]
        low = [scene.means[some, axis] < middle for scene, some in zip(self.scenes, rows, strict=True)]
        if not any(some.any() for some in low):  # more than half of them are at the lowest place
            low = [scene.means[some, axis] <= middle for scene, some in zip(self.scenes, rows, strict=True)]
        children = [
            self.node([some[one == side] for some, one in zip(rows, low, strict=True)])
            for side in (True, False)
        ]
        corners = [np.array([child["bound"][name] for child in children]) for name in ("min", "max")]
        return {
            "bound": {"min": corners[0].min(axis=0).tolist(), "max": corners[1].max(axis=0).tolist()},
            "children": children,
        }

    def leaf(self, rows: list[np.ndarray]) -> dict[str, Any]:
        lods, lows, highs = {}, [], []
        for level, (scene, some) in enumerate(zip(self.scenes, rows, strict=True)):
            if not len(some):
                continue
            some = some[morton_order(scene.means[some])]
            names = [name for name, (one, _) in self.files.items() if one == level]
            held = sum(map(len, self.files[names[-1]][1])) if names else CHUNK
            if held >= CHUNK:
                names, held = [f"{level}_{len(names)}{self.tag}/{META}"], 0
            self.files.setdefault(name := names[-1], (level, []))[1].append(some)
            lods[str(level)] = {"file": list(self.files).index(name), "offset": held, "count": len(some)}
            part = scene.select(some)  # ellipsoids of one sigma
            scales = np.exp(part.log_scales.astype(np.float64))
            half = np.einsum("nij,nj->ni", np.abs(rotation_matrices(part.quats)), scales)
            lows.append((part.means - half).min(axis=0))
            highs.append((part.means + half).max(axis=0))
        low = np.min(lows, axis=0) if lows else np.zeros(3)
        high = np.max(highs, axis=0) if lows else np.zeros(3)
        rounded = lambda corner: [float(f"{value:.{DIGITS}g}") for value in corner]
        return {"bound": {"min": rounded(low), "max": rounded(high)}, "lods": lods}


def _with_degree(scene: Scene, degree: int) -> Scene:
    """The scene with zeros in SH bands that it does not have."""
    missing = SH_COEFFICIENTS[degree] - scene.sh.shape[1]
    return replace(scene, sh=np.pad(scene.sh, ((0, 0), (0, missing), (0, 0)))) if missing else scene


def _checked(path: Path) -> dict[str, Any]:
    """lod-meta.json with a valid version, lodLevels, filenames. Raises FormatError (without the name of the
    file), as the functions below."""
    meta = json_object(path, MAX_INDEX)
    if meta is None or meta.get("version", VERSION) != VERSION:
        raise FormatError(
            f"has no JSON of version {VERSION} and at most {MAX_INDEX:,} bytes that can be read{BROKEN}"
        )
    names, number = meta.get("filenames"), meta.get("lodLevels")
    if not number or not is_whole(number, MAX_LEVELS):
        raise FormatError(f"has no valid lodLevels{BROKEN}")
    if not isinstance(names, list) or not all(
        isinstance(name, str) and UNIT.fullmatch(name) and ".." not in name for name in _names(meta)
    ):
        raise FormatError(f"names files that are not in folders beside it{BROKEN}")
    return meta


def _names(meta: dict[str, Any]) -> list[Any]:
    return [*meta["filenames"], *([meta["environment"]] if "environment" in meta else [])]


def _units_of(meta: dict[str, Any], level: int, most: int) -> list[str]:
    """The names of the files with Gaussians of the level, at most so many, and of the environment."""
    names, found, nodes, counted = meta["filenames"], set(), [meta.get("tree")], 0
    while nodes:
        node = nodes.pop()
        children = node.get("children", []) if isinstance(node, dict) else None
        lods = node.get("lods", {}) if isinstance(node, dict) else None
        if not isinstance(children, list) or not isinstance(lods, dict):
            raise FormatError(f"has a tree that cannot be read{BROKEN}")
        nodes += children
        if str(level) not in lods:
            continue
        part = lods[str(level)]
        number, count = (part.get(name) if isinstance(part, dict) else None for name in ("file", "count"))
        if not (is_whole(number, len(names) - 1) and is_whole(count)):
            raise FormatError(f"has a leaf that names no file{BROKEN}")
        found.add(number)
        counted += count
    refuse_many(counted, most)
    environment = [meta["environment"]] if "environment" in meta else []
    return list(dict.fromkeys([*(names[number] for number in sorted(found)), *environment]))


FORMAT = SplatFormat(
    name="streamed-sog",
    label="Streamed SOG",
    suffixes=(),
    read_parts=read_parts,
    write=write,
    quantises=True,
    limits=limits,
    index=INDEX,
    parts=parts,
    carries=("antialiased",),
    needs=images.lack,
)
