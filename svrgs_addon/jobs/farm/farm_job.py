"""A job for a farm: a folder with tasks, which any number of machines do in any order. Everything that a task
needs to know is in job.json.

    job.json             schema, version, root, to, and the tasks: name, scene, and the options of `svrgs
                         prune`
    results/NAME.spz     what a task wrote, in the format of `to`; results/NAME.json, its result, is written
                         last
    report/              table and chart over all tasks (summary.py)
    captures/            the splats of a job that Blender made
    template.json, parameter_values.json, asset_references.json      the job in Open Job Description
    flamenco.json        the job for the manager of Flamenco; both: engines.py

Paths in job.json are relative to `root`, the folder of the captures, or begin with OWN, the folder of the job
itself; a worker that has the captures elsewhere gives its own root. job.json is read like a file of a
stranger: options are checked by name, type and range, and names of tasks become names of files only if they
are plain.
"""

from __future__ import annotations

import os
import re
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from ... import __version__
from ...files.atomic import write_json
from ...files.reading import json_object
from ...files.registry import USUAL, suffixes
from ...prune.options import PruneOptions
from ...system.errors import FormatError, SceneError
from ...system.file_names import extended, real
from ...system.foreign import own
from ...system.option_kinds import check_mapping, default_of, options_of

SCHEMA, JOB, RESULTS, CAPTURES = 1, "job.json", "results", "captures"  # captures: of a job that Blender made
LARGEST = 1 << 24  # bytes of job.json, and of a result
NAME, UNUSUAL = re.compile(r"\w[\w.+ -]{0,200}"), re.compile(r"^\W|[^\w.+ -]")
OWN = "{job}/"  # begins a path within the folder of the job
INSIDE = ("data", "cameras", "masks", "lpips_weights")  # options with a path that may lie in the root
# options that are not of a farm: it resumes by itself, and one machine's seconds are not another's
LEFT_OUT = ("resume", "quiet", "time")


@dataclass(frozen=True)
class Task:
    """One scene that is pruned in one way. scene and the paths in options (of INSIDE) are relative to the
    root, begin with OWN, or are absolute."""

    name: str
    scene: str
    options: dict[str, Any]


@dataclass(frozen=True)
class FarmJob:
    """The tasks in `folder`, on captures in `root`. to: suffix of the results."""

    folder: Path
    root: Path
    tasks: tuple[Task, ...]
    to: str = USUAL.suffixes[0]

    @classmethod
    def read(cls, folder: str | Path, root: str | Path | None = None) -> FarmJob:
        """root: where the captures lie on this machine; None: where they lay when the job was made. Raises
        FormatError, SceneError."""
        folder = extended(folder)
        path = folder / JOB
        try:
            contents = json_object(path, LARGEST) or {}
        except OSError as error:
            raise SceneError(
                f"{path}: cannot be read ({error.strerror}); make the job with svrgs farm export"
            ) from None
        if (
            contents.get("schema") != SCHEMA
            or contents.get("to") not in suffixes(written=True)
            or not isinstance(contents.get("tasks"), list)
            or not isinstance(contents.get("root"), str)
        ):
            raise FormatError(f"{path}: is no farm job of this version; make it again with svrgs farm export")
        try:
            tasks = tuple(map(_checked, contents["tasks"]))
            return cls(folder, extended(root or contents["root"]), tasks, contents["to"])
        except SceneError as error:
            raise FormatError(f"{path}: {error}") from None

    def write(self):
        """Writes job.json. Raises SceneError."""
        facts = {"schema": SCHEMA, "version": __version__, "root": str(self.root), "to": self.to}
        write_json(self.folder / JOB, facts | {"tasks": [asdict(task) for task in self.tasks]}, indented=True)

    def options(self, task: Task) -> PruneOptions:
        """The options of the task on this machine; a run of it that was interrupted goes on."""
        values = check_mapping(PruneOptions, task.options, in_job=False)
        values |= {name: self._place(task.options[name]) for name in INSIDE if task.options.get(name)}
        values |= {"scene": self._place(task.scene), "out": self.out(task)}
        return PruneOptions(**values, resume=not values.get("quick", False), quiet=True)

    def out(self, task: Task) -> Path:
        """Raises FormatError, as result_path(), if a link is on the way."""
        return own(self.folder, RESULTS, f"{task.name}{self.to}")

    def result_path(self, task: Task) -> Path:
        return own(self.folder, RESULTS, f"{task.name}.json")

    def result(self, task: Task) -> dict[str, Any] | None:
        """The result of the task; None if it is not done, or was done with other options."""
        try:
            found = json_object(self.result_path(task), LARGEST)
        except OSError:
            return None
        same = (
            found is not None
            and found.get("task") == {"scene": task.scene, "options": task.options}
            and self.out(task).is_file()
        )
        return found if same else None

    def _place(self, path: str) -> Path:
        return extended(self.folder / path.removeprefix(OWN) if path.startswith(OWN) else self.root / path)


def refuse_folder(folder: Path):
    """Raises SceneError for a folder that holds other things than a farm job."""
    if folder.exists() and not (folder.is_dir() and (not any(folder.iterdir()) or (folder / JOB).is_file())):
        raise SceneError(f"{folder}: is not empty, and no farm job; choose another folder")


def tasks_of(
    root: Path,
    scenes: Sequence[tuple[str, Path, Path | None]],
    ways: Sequence[dict[str, Any]],
    options: PruneOptions,
) -> tuple[Task, ...]:
    """A task for each scene (name, splat, dataset) and each way (method, target). Raises SceneError if two
    would have the same name."""
    common = {name: getattr(options, name) for name in options_of(PruneOptions) if name not in LEFT_OUT}
    common = {
        name: relative(root, value) if name in INSIDE else _plain(value)
        for name, value in common.items()
        if value != default_of(PruneOptions, name)
    }
    tasks = []
    for name, scene, dataset in scenes:
        placed = {"data": relative(root, dataset)} if dataset else {}
        for way in ways:
            words = (f"{100 * word:g}" if isinstance(word, float) else str(word) for word in way.values())
            title = UNUSUAL.sub("_", "-".join([name, *words]))
            task = {"name": title, "scene": relative(root, scene), "options": common | placed | way}
            tasks.append(_checked(task))
    refuse_same_names([task.name for task in tasks])
    return tuple(tasks)


def refuse_same_names(names: Sequence[str]):
    """Raises SceneError for two tasks whose files would be one. Some systems do not tell upper and lower case
    apart."""
    lower = [name.lower() for name in names]
    if same := next((name for name in names if lower.count(name.lower()) > 1), ""):
        raise SceneError(f"two tasks would have the name '{same}': make two jobs")


def common_folder(folders: Sequence[Path]) -> Path | None:
    """The folder that holds all of them; None if they lie on several drives, or if there are none."""
    try:
        return Path(os.path.commonpath([folder.absolute() for folder in folders]))
    except ValueError:
        return None


def relative(root: Path, path: Path) -> str:
    """The path relative to the root, with slashes; absolute if it lies elsewhere."""
    place, base = real(path), real(root)
    return Path(place).relative_to(base).as_posix() if Path(place).is_relative_to(base) else str(place)


def _plain(value: Any) -> Any:
    return str(value) if isinstance(value, Path) else list(value) if isinstance(value, tuple) else value


def _checked(found: Any) -> Task:
    """A task of job.json. Raises SceneError (without the name of the file)."""
    named = isinstance(found, dict) and isinstance(found.get("name"), str)
    if not named or not isinstance(found.get("scene"), str):
        raise SceneError("has a task without a name or a scene")
    if not NAME.fullmatch(found["name"]):
        raise SceneError(f"the name of a task, '{found['name'][:60]}', is no plain name of a file")
    check_mapping(PruneOptions, found.get("options"), in_job=False)
    if own := [name for name in LEFT_OUT if name in found["options"]]:
        raise SceneError(
            f"the task '{found['name']}' has the option {own[0]}, which tasks of a farm do not take"
        )
    return Task(found["name"], found["scene"], found["options"])
