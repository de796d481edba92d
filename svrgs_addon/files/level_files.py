"""Levels of detail that a job writes: beside its output, or, as a streamed SOG, in it."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path

from ..scene.concatenate import concatenated
from ..scene.gaussians import Scene
from . import streamed_sog
from .registry import read_back, size_on_disk, split_name, write_scene
from .sh_rounding import SeenFrom


def level_files(out: Path, shares: Iterable[float]) -> dict[float, Path]:
    """The file of each level of detail by its share: OUT_50.ply for 0.5. None if the output holds all."""
    if holds_levels(out):
        return {}
    name, suffix = split_name(out)
    return {share: out.with_name(f"{name}_{100 * share:g}{suffix}") for share in shares}


def holds_levels(out: Path) -> bool:
    return out.name == streamed_sog.INDEX


@dataclass(frozen=True)
class StoredScene:
    """A scene as its file holds it."""

    path: Path
    bytes: int  # that it takes; of a level in a streamed SOG, the files with its Gaussians
    scene: Scene


def write_with_levels(
    out: Path,
    shares: Sequence[float],
    scenes: Sequence[Scene],
    quantise: float,
    seen: Sequence[SeenFrom | None],
) -> list[StoredScene]:
    """Writes the result, scenes[0], and its levels of detail. quantise, seen (of each scene): as of
    write_scene(). Raises SceneError, FormatError."""
    if holds_levels(out):
        streamed_sog.write_levels(out, scenes, quantise, seen)
        return [
            StoredScene(
                out,
                streamed_sog.level_bytes(out, level),
                concatenated(list(streamed_sog.read_level(out, level)), columns=True),
            )
            for level in range(len(scenes))
        ]
    written = []
    for path, scene, views in zip([out, *level_files(out, shares).values()], scenes, seen, strict=True):
        write_scene(path, scene, quantise=quantise, seen=views)
        written.append(StoredScene(path, size_on_disk(path), read_back(path, scene)))
    return written
