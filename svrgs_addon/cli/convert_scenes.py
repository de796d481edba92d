"""`svrgs convert`: writes splats in another format, cropped, turned or with fewer spherical harmonics on the
way."""

from __future__ import annotations

import argparse
import contextlib
import glob
import logging
from collections.abc import Iterator
from dataclasses import fields, replace
from functools import cache
from pathlib import Path

import numpy as np

from ..files import registry
from ..files.level_files import holds_levels
from ..files.memory_mapped import mapped_scene
from ..files.sh_rounding import SeenFrom, without_bands
from ..files.streamed_sog import write_levels
from ..prune.belonging import MIN_SEEN, Seen, seen_of
from ..prune.door import check_files, check_views, outputs
from ..prune.seen import FEWEST_VIEWS, bytes_of, fewer_bands, seen_from
from ..prune.selection.criteria import in_box
from ..scene.affine import scaled, transformed
from ..scene.camera import Camera
from ..scene.gaussians import Scene
from ..scene.grade import Grade, graded
from ..system import memory
from ..system.errors import MemoryShort, SceneError, SplatError, TooMany
from ..system.file_names import extended, real
from ..views.dataset import load_dataset
from .convert_options import ConvertOptions
from .option_parser import options_from
from .render_views import memory_of

LARGE = 1 << 28  # bytes of a file that is read in parts, by way of the disk


def convert_scenes(args: argparse.Namespace) -> Iterator[dict]:
    """Converts one file after another. Yields scene and out of each, with count, sh_degree and the bytes
    before and after; or skipped; or, with several inputs, the error of one. Raises SplatError."""
    options = options_from(ConvertOptions, args)
    if holds_levels(args.out) and len(args.inputs) > 1:
        yield _convert_levels(
            [scene for path in args.inputs for scene in _files(Path(path))], args.out, options
        )
        return
    pairs = _pairs([Path(path) for path in args.inputs], args.out, options)
    for scene, out in pairs:
        line = {"scene": str(scene), "out": str(out)}
        if len(pairs) > 1 and out.exists() and not options.overwrite:
            yield line | {"skipped": "the output exists"}
            continue
        try:
            yield line | _convert(scene, out, options)
        except SplatError as error:
            if len(pairs) == 1:
                raise
            yield line | {"error": str(error)}


def as_text(line: dict) -> str:
    if problem := line.get("error") or line.get("skipped"):
        return problem if "error" in line else f"{line['out']}: skipped, {problem}"
    sizes = " -> ".join(memory.size_text(line[name]) for name in ("bytes_before", "bytes"))
    seen = f"; {Seen(line['seen'], line['seen_views']).sentence()}" if "seen" in line else ""
    return (
        f"{line['scene']}: {line['count']:,} Gaussians, SH degree {line['sh_degree']}, {sizes}; saved"
        f" {line['out']}{seen}"
    )


def _convert(path: Path, out: Path, options: ConvertOptions) -> dict:
    splat_format = registry.format_to_write(out)
    with outputs(path, [out]), _loaded(path, out, options) as scene:
        if not scene.count:
            raise SceneError(f"{path}: no Gaussian is inside the box, so no file was written")
        scene, seen, by_views = _by_views(scene, path, out, options)
        if options.quantise != 1 and not scene.sh_degree:
            logging.warning("%s: has no spherical harmonics, so --quantise changes nothing", path)
        registry.write_scene(out, scene, options.spz_version or 0, options.quantise, seen)
        facts = {"count": scene.count, "sh_degree": min(scene.sh_degree, splat_format.most_degree)}
        facts |= by_views
    return facts | {"bytes_before": registry.size_on_disk(path), "bytes": registry.size_on_disk(out)}


def _convert_levels(paths: list[Path], out: Path, options: ConvertOptions) -> dict:
    """Levels of detail in files of their own as one streamed SOG, the largest one first."""
    for path in paths:
        check_files(path, [out])
    with outputs(None, [out]):
        changed = (_changed(registry.load_scene(path), options) for path in paths)
        scenes = sorted(changed, key=lambda scene: -scene.count)
        if not scenes[-1].count:
            raise SceneError(
                f"{out}: no Gaussian of one of the levels is inside the box, so no file was written"
            )
        views = [_by_views(one, out, out, options) for one in scenes]
        scenes = [scene for scene, *_ in views]
        write_levels(out, scenes, options.quantise, [seen for _, seen, _ in views])
    facts: dict = {"scene": ", ".join(map(str, paths)), "out": str(out)}
    facts |= {"count": scenes[0].count, "sh_degree": scenes[0].sh_degree}
    facts |= {"bytes_before": sum(map(registry.size_on_disk, paths)), "bytes": registry.size_on_disk(out)}
    return facts | {"levels": [scene.count for scene in scenes]}


@contextlib.contextmanager
def _loaded(path: Path, out: Path, options: ConvertOptions) -> Iterator[Scene]:
    """The changed scene; the values of a large one lie in files."""
    if whole := _whole(path):
        yield _changed(whole, options)
        return
    with mapped_scene((_changed(part, options) for part in registry.load_parts(path)), out) as scene:
        yield scene


def _whole(path: Path) -> Scene | None:
    """The scene of a file; None if it is large."""
    try:
        return registry.load_scene(path) if registry.size_on_disk(path) < LARGE else None
    except (MemoryShort, TooMany):
        return None


def _by_views(
    scene: Scene, path: Path, out: Path, options: ConvertOptions
) -> tuple[Scene, SeenFrom | None, dict]:
    """The changed scene, whose bands are left out by what the training views of --data show; from where they
    see it; and what share of it they see, for the result. Without --data: as it is, None, and nothing. Raises
    SceneError, FormatError."""
    if options.data is None:
        return scene, None, {}
    splat_format = registry.format_to_write(out)
    degree = min(_degree(options), splat_format.most_degree)
    if not scene.sh_degree:
        logging.warning("%s: has no spherical harmonics, so --data changes nothing", path)
        return scene, None, {}
    if not (splat_format.quantises or scene.sh_degree > degree):
        raise SceneError(
            f"{out}: an SPZ or a SOG is rounded by views, and spherical harmonics are left out by them: leave"
            " --data out"
        )
    to_original = np.diag([1 / options.scale] * 3 + [1.0]) @ np.linalg.inv(_matrix(options))
    cameras = [
        replace(camera.moved(to_original), unit=options.scale * camera.unit)
        for camera in _training_cameras(options.data)
    ]
    check_views(scene, cameras, cameras, str(path))
    needed = memory_of(scene.count, cameras) + bytes_of(scene.count, cameras)
    memory.refuse_excess(f"{path}: rendering it", needed)
    seen = seen_of(scene, cameras)
    if seen.share < MIN_SEEN:
        raise SceneError(
            f"{path}: {seen.sentence()}, and the others would be stored for where nobody looks from: give the"
            " dataset of this splat, or leave --data out"
        )
    if len(cameras) < FEWEST_VIEWS:
        raise SceneError(
            f"{options.data}: has {len(cameras)} training views, and {FEWEST_VIEWS} are needed: leave --data"
            " out"
        )
    for sentence in registry.higher_bands(scene, splat_format):
        logging.warning("%s: %s", out, sentence)
    scene = fewer_bands(scene, degree, cameras)
    return scene, seen_from(scene, cameras, out), seen.facts()


def _changed(scene: Scene, options: ConvertOptions) -> Scene:
    """The scene after crop, scale, rotation, move, with other colours and, without --data, fewer bands."""
    if options.box:
        scene = scene.select(np.flatnonzero(in_box(scene.means, options.box)))
    scene = transformed(scaled(scene, options.scale), _matrix(options))
    names = [field.name for field in fields(Grade) if hasattr(options, field.name)]
    scene = graded(scene, Grade(**{name: getattr(options, name) for name in names}))
    return scene if options.data else without_bands(scene, _degree(options))


def _degree(options: ConvertOptions) -> int:
    """The highest SH degree that is asked for."""
    return 3 if options.sh_degree is None else options.sh_degree


@cache
def _training_cameras(data: Path) -> list[Camera]:
    """Of the dataset, which is read once for all inputs. Raises SceneError, FormatError."""
    return load_dataset(data, cameras_only=True).training_cameras


def _matrix(options: ConvertOptions) -> np.ndarray:
    """(4, 4): the rotation, then the move."""
    matrix = np.eye(4)
    for axis, angle in enumerate(np.radians(options.rotate)):
        turn, (one, other) = np.eye(4), [k for k in range(3) if k != axis]
        sign = -1 if axis == 1 else 1  # from z to x
        turn[one, one] = turn[other, other] = np.cos(angle)
        turn[other, one], turn[one, other] = sign * np.sin(angle), -sign * np.sin(angle)
        matrix = turn @ matrix
    matrix[:3, 3] = options.move
    return matrix


def _pairs(inputs: list[Path], out: Path, options: ConvertOptions) -> list[tuple[Path, Path]]:
    """Each input with its output. Raises SceneError, before anything is written, if names do not tell where
    to or if two would be one."""
    found = [scene for path in inputs for scene in _files(path)]
    known = registry.split_name(out)[1].lower() in registry.suffixes(written=True) and not out.is_dir()
    if known and len(found) == 1 and not options.to:
        return [(found[0], out)]
    if known and not options.to:
        raise SceneError(
            f"{out}: is the name of a file, but there are {len(found)} inputs; name a folder and give --to"
            " .spz"
        )
    if not options.to:
        raise SceneError(
            f"{out}: has no suffix that says a format; give --to with one of"
            f" {', '.join(registry.suffixes(written=True))}"
        )
    suffix = options.to if options.to.startswith(".") else f".{options.to}"
    registry.format_to_write(out / f"x{suffix}")
    outs = [out / (registry.split_name(scene)[0] + suffix) for scene in found]
    places = list(map(real, outs))
    if len(set(places)) < len(outs):
        twice = next(one for one, place in zip(outs, places, strict=True) if places.count(place) > 1)
        raise SceneError(f"{twice}: would be the output of two inputs; convert them into separate folders")
    return list(zip(found, outs, strict=True))


def _files(path: Path) -> list[Path]:
    """The files of a path, a folder or a pattern. Raises SceneError if there are none."""
    if path.is_dir() and not registry.is_splat_folder(path):
        named = lambda one: one.is_file() and one.name.lower().endswith(registry.suffixes())
        splat = lambda one: not one.name.startswith(".") and (named(one) or registry.is_splat_folder(one))
        found = sorted(filter(splat, path.iterdir()))
    elif not path.exists() and glob.has_magic(str(path)):
        found = [extended(name) for name in sorted(glob.glob(str(path)))]
    else:
        return [path]
    if not found:
        raise SceneError(f"{path}: holds no splat; those are {', '.join(registry.suffixes())}")
    return found
