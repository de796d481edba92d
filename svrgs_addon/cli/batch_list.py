"""The list of scenes of `svrgs prune`, from splat files, scene folders, and folders that hold scene
folders."""

from __future__ import annotations

import logging
import re
from dataclasses import dataclass
from pathlib import Path

from ..files import registry
from ..files.level_files import level_files
from ..system.errors import SceneError
from ..system.file_names import real

PRUNED = "_pruned"  # end of the default name of an output, before its suffix
# what a folder of a capture holds beside its splat: point clouds of COLMAP, and exported pages
CLOUDS, PAGE = ("sparse", "dense", "stereo"), "index.html"
# end of the default names of outputs and of their levels of detail
OUTPUT = re.compile(rf"{PRUNED}(_[0-9.]+)?$")


@dataclass(frozen=True)
class Item:
    """One scene to prune."""

    name: str
    scene: Path
    data: Path | None  # folder of its dataset; None: not found
    out: Path
    levels: tuple[Path, ...] = ()  # files of its levels of detail


def expand(
    paths: list[Path],
    data: Path | None,
    out: Path | None,
    report: Path | None = None,
    levels: tuple[float, ...] = (),
) -> list[Item]:
    """All scenes under `paths`, in order.

    A folder with a splat is one scene, and the folder is its dataset. In a folder without a splat, each
    folder is tried as a scene. data: a dataset for all scenes instead. out: a folder, or a file for a
    single scene; None: the folder of each scene. report: the folder of the reports, which are named after the
    scenes. levels: shares of the levels of detail that are written too. Raises SceneError if a path does not
    exist, if a folder has no scene, if two scenes would have the same output or report, if an output of one
    is another one, if an output that was not asked for is a link, and if `out` is a file for several scenes.
    """
    found = [pair for path in paths for pair in _scenes(path, out)]
    names = [name for name, _ in found]
    if len(set(names)) < len(names) and (out or report):
        raise SceneError(
            f"two scenes have the name '{next(n for n in names if names.count(n) > 1)}': prune them into"
            " separate folders"
        )
    alone = len(found) == 1 and not paths[0].is_dir()
    to_file = (
        out is not None
        and not out.is_dir()
        and (
            out.name.lower().endswith((*registry.suffixes(written=True), *registry.INDEXES))
            or (alone and out.suffix != "")
        )
    )
    if to_file and len(found) > 1:
        raise SceneError(
            f"{out}: is the name of a file, but there are {len(found)} scenes; give a folder instead"
        )
    items = []
    for name, scene in found:
        target = default_output(scene) if out is None else out
        if out and not to_file:
            target = out / f"{name}{registry.USUAL.suffixes[0]}"
        items.append(
            Item(name, scene, data or _dataset(scene), target, tuple(level_files(target, levels).values()))
        )
    _refuse_lost_files(items)
    return items


def _refuse_lost_files(items: list[Item]) -> None:
    """Raises SceneError if an output of one scene is another scene of the list, or lies where an output of
    another one does. (prune() refuses the scene itself.)"""
    scenes, owners = {real(item.scene): item for item in items}, dict[Path, Item]()
    for item in items:
        for out in (item.out, *item.levels):
            other = scenes.get(real(out), item)
            if other is not item:
                raise SceneError(
                    f"{other.scene}: is both a scene to prune and an output of {item.scene}; leave one out,"
                    " or choose another folder with --out"
                )
            owner = owners.setdefault(real(out), item)
            if owner is not item:
                raise SceneError(
                    f"{out}: would be an output of both {owner.scene} and {item.scene}; prune one of them"
                    " into another folder"
                )


def same_file(a: Path, b: Path) -> bool:
    """Whether both paths lead to the same place, which need not exist. A loop of links leads nowhere."""
    return real(a) == real(b)


def _scenes(path: Path, out: Path | None) -> list[tuple[str, Path]]:
    if not path.exists():
        raise SceneError(f"{path}: there is no such file or folder")
    if not path.is_dir() or registry.is_splat_folder(path):
        return [(registry.split_name(path)[0], path)]
    if out and same_file(path, out):
        raise SceneError(
            f"{path}: is the folder of both scenes and outputs; choose another folder for the outputs"
        )
    own = _splat_in(path)
    inside = (folder for folder in sorted(path.iterdir()) if folder.is_dir())
    folders = [folder for folder in inside if not (out and same_file(folder, out))]
    below = [(folder.name, splat) for folder in folders if (splat := _splat_in(folder))]
    others = [name for name, splat in below if name not in CLOUDS and not (splat.parent / PAGE).exists()]
    if own and others:
        names = ", ".join(others[:3]) + (", …" if len(others) > 3 else "")
        logging.warning("%s: is pruned alone; the folders beside it hold splats, too: %s", own, names)
    if own:
        return [(path.name, own)]
    if not below:
        raise SceneError(
            f"{path}: holds no splat and no folders with one; splats are {', '.join(registry.suffixes())}"
        )
    return below


def _splat_in(folder: Path) -> Path | None:
    """The splat of a folder: the last iteration in the point_cloud folder of a 3DGS run, or else the only
    splat file, outputs of `svrgs prune` left out. None if there is no splat.

    If there are several, the folder itself is returned: reading it fails with a sentence, and the other
    scenes are pruned.
    """
    trained = {
        p: p.parent.name.removeprefix("iteration_")
        for p in _splats(folder, "point_cloud/iteration_*/point_cloud")
    }
    numbered = [p for p, number in trained.items() if number.isdecimal()]
    if numbered:  # the folder of a 3DGS run also holds input.ply, which has only sparse points
        return max(numbered, key=lambda p: int(trained[p]))
    other = lambda p: OUTPUT.search(registry.split_name(p)[0]) or p.name.startswith(".")
    files = [p for p in sorted(_splats(folder, "*")) if not other(p)]
    return folder if len(files) > 1 else files[0] if files else None


def _splats(folder: Path, pattern: str) -> list[Path]:
    """The splat files of all formats whose names without suffix match the pattern."""
    return list(
        dict.fromkeys(path for suffix in registry.suffixes() for path in folder.glob(pattern + suffix))
    )


def _dataset(scene: Path) -> Path | None:
    """The nearest of the three folders above the splat that holds a COLMAP model or transforms.json; None if
    none does."""
    for folder in list(scene.absolute().parents)[:3]:
        if (folder / "sparse").is_dir() or any(
            (folder / name).exists() for name in ("cameras.bin", "cameras.txt", "transforms.json")
        ):
            return folder
    return None


def default_output(scene: Path, option: str = "--out") -> Path:
    """SCENE_pruned.spz beside the scene. Raises SceneError if that is a link. option: what names another
    output, for the sentence."""
    out = scene.with_name(f"{registry.split_name(scene)[0]}{PRUNED}{registry.USUAL.suffixes[0]}")
    if out.is_symlink():  # a downloaded dataset must not lead outputs to another place
        raise SceneError(f"{out}: is a link to {out.readlink()}; name the output with {option}")
    return out
