"""The size of a file as the goal: as many Gaussians as fit into it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from ..files.level_files import holds_levels
from ..files.registry import format_to_write, round_trip, size_on_disk, split_name, write_scene
from ..files.sh_rounding import SeenFrom
from ..files.splat_format import SplatFormat
from ..finetune.plan import Plan
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..system.errors import SceneError
from .door import degree_to_keep
from .options import PruneOptions
from .seen import fewer_bands, seen_from

MOST, TRIES = 1 << 16, 6  # Gaussians of a part of the scene that is written; parts, at most
# share of the size that Gaussians of the original fill: those of a result take 3 to 15 % more, and some more
# without the views of the job, if the file is written later; and where the values do not matter
ROOM, ROOM_LATER, ALMOST_ALL = 0.94, 0.85, 0.998
CLOSE = 0.01  # change of the count in a try after which no other follows
# where less than FEW of the scene's Gaussians fit with all SH bands, a lower degree leaves room for more, and
# these show more (docs/results.md, "Fewer bands, more Gaussians?"), if they are at least WORTH times as many
FEW, FEWER_BANDS, WORTH = 0.125, 2, 1.1
# on the error in SH, if more bytes are needed than foreseen
FACTORS = (1.0, 1.1, 1.25, 1.6, 2.0, 2.5, 3.2, 4.0)


@dataclass(frozen=True)
class FileSize:
    """The most bytes of a file in a format, with SH up to a degree."""

    bytes: float
    splat_format: SplatFormat
    degree: int
    asked: bool = True  # whether the degree is that of --sh-degree
    later: bool = False  # it is written from the result, by views or without them
    suffix: str = ""  # of the file, if the format has several

    def planned(self, plan: Plan, scene: Scene, cameras: Sequence[Camera]) -> tuple[Plan, list[str]]:
        """The plan with as many Gaussians as fit; where they are few, with fewer SH bands, and a sentence
        that says so. Raises SceneError, FormatError."""
        count, degree = self.count_of(scene, cameras), min(self.degree, scene.sh_degree)
        if self.asked or degree <= FEWER_BANDS or count >= FEW * scene.count:
            return replace(plan, target=count), []
        more = replace(self, degree=FEWER_BANDS).count_of(scene, cameras)
        if more < WORTH * count:
            return replace(plan, target=count), []
        sentence = (
            f"spherical harmonics end at degree {FEWER_BANDS}, so that {more:,} Gaussians fit instead of"
            f" {count:,}, which looks better; --sh-degree {degree} keeps all"
        )
        return replace(plan, target=more, sh_degree=FEWER_BANDS), [sentence]

    def count_of(self, scene: Scene, cameras: Sequence[Camera]) -> int:
        """How many Gaussians fit, 1 to N, of a file that is written by what the views see. Raises SceneError,
        FormatError."""
        scene = fewer_bands(scene, self.degree, ())
        seen = seen_from(scene, cameras, self.splat_format)
        ways = (seen, None) if self.later and seen else (seen,)
        size_of = lambda count: max(
            bytes_of(scene, count, self.splat_format, way, self.suffix) for way in ways
        )
        least, count = size_of(1), scene.count
        room = ALMOST_ALL if self.splat_format.size else ROOM_LATER if self.later else ROOM
        if least > self.bytes:
            raise SceneError(
                f"a file of {self.bytes / 1e6:g} MB holds no Gaussian: ask for more than {least / 1e6:.2g} MB"
            )
        for _ in range(TRIES):
            each = (size_of(count) - least) / max(1, count - 1)  # bytes of one more Gaussian
            more = max(0.0, room * self.bytes - least) / each if each > 0 else scene.count
            former, count = count, min(scene.count, 1 + int(more))
            if abs(count - former) <= CLOSE * count:
                break
        return count

    def quantise_of(self, scene: Scene, seen: SeenFrom | None, splat_format: SplatFormat) -> float:
        """The least factor on the error in SH with which a file is not larger; 1 for one in another format.
        Raises SceneError, FormatError."""
        if splat_format != self.splat_format or not (splat_format.quantises and scene.sh_degree):
            return 1.0
        size_with = lambda factor: round_trip(scene, splat_format, factor, seen)[1]
        return next((one for one in FACTORS if size_with(one) <= self.bytes), FACTORS[-1])

    def notes(self, quantise: float, written: int, splat_format: SplatFormat) -> list[str]:
        """What the user must know of a file with so many bytes, written with this factor on the error in
        SH."""
        if splat_format != self.splat_format:
            return []
        sentences = []
        if quantise != 1:
            sentences.append(
                f"spherical harmonics are stored more coarsely, as by svrgs convert --quantise {quantise:g}"
                + (", so that the file is no larger than asked for" if written <= self.bytes else "")
            )
        if written > self.bytes:
            sentences.append(
                f"the file has {written / 1e6:.4g} MB, more than the {self.bytes / 1e6:.4g} MB asked for: ask"
                f" for {0.98 * self.bytes**2 / written / 1e6:.4g} MB"
            )
        return sentences


def bytes_of(
    scene: Scene, count: int, splat_format: SplatFormat, seen: SeenFrom | None = None, suffix: str = ""
) -> int:
    """Bytes of a file with `count` of the scene's Gaussians, by those of at most MOST that are drawn at
    random. suffix: as of round_trip(). Raises SceneError, FormatError."""
    some = min(count, MOST)
    rows = np.sort(np.random.default_rng(0).permutation(scene.count)[:some])
    part = seen.select(rows) if seen else None
    return round_trip(scene.select(rows), splat_format, seen=part, suffix=suffix)[1] * count // some


def write_sized(
    path: Path, scene: Scene, seen: SeenFrom | None, size: FileSize | None
) -> tuple[float, list[str]]:
    """Writes the scene, of the size that is asked for, if one is. seen: as of write_scene(). Returns the
    factor on the error in SH, and what the user must know. Raises SceneError, FormatError."""
    kind = format_to_write(path)
    quantise = size.quantise_of(scene, seen, kind) if size else 1.0
    write_scene(path, scene, quantise=quantise, seen=seen)
    return quantise, size.notes(quantise, size_on_disk(path), kind) if size else []


def asked_size(options: PruneOptions) -> FileSize | None:
    """The size that is the goal; None if it is not. Raises SceneError."""
    if options.target_size is None:
        if options.target_format:
            raise SceneError("--target-format is about --target-size: add it, or leave --target-format out")
        return None
    suffix = options.target_format and f".{options.target_format.removeprefix('.')}"
    name = f"x{suffix}" if suffix else options.out or ""
    splat_format = format_to_write(name)
    if options.out is not None and holds_levels(options.out):
        raise SceneError(f"{options.out}: --target-size is about one file, and this output has several")
    degree = min(degree_to_keep(options), splat_format.most_degree)
    later = options.out is None or splat_format != format_to_write(options.out)
    asked = options.sh_degree is not None
    return FileSize(options.target_size * 1e6, splat_format, degree, asked, later, split_name(name)[1])
