"""The finished tasks of a job by blocks. They are listed in tasks.json, beside the blocks. A job that was stopped or killed continues with the other tasks."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import FormatError
from ..files.atomic import atomic_write
from ..files.opened import json_object

if TYPE_CHECKING:  # jobs of Blender need no more of it
    from .blocks import Tell

FILE, LARGEST = "tasks.json", 1 << 22


class Tasks:
    """done: names of the tasks that are done; none of a job that begins. total: how many tasks the job has, 0 as long as that is not known."""

    def __init__(self, folder: Path, identity: str, resume: bool):
        """identity: of settings and inputs. Raises FormatError if the job in the folder is another one."""
        self._path, self._identity, self.total, self.done = folder / FILE, identity, 0, list[str]()
        found = _read(self._path) if resume else None
        if found is None:
            self._path.unlink(missing_ok=True)
        elif found["identity"] != identity:
            raise FormatError(f"{self._path}: this job is one with other settings or inputs; delete {folder} to start again")
        else:
            self.done = found["done"]

    def told(self, tell: Tell) -> Tell:
        """`tell` with the share of the whole job, 0 to 1, instead of that of one task. Measuring the result counts as one more task. 0 while `total` is 0."""
        return lambda text, share: tell(text, (len(self.done) + share) / (self.total + 1) if self.total else 0.0)

    def once(self, name: str, work: Callable[[], object]):
        """Does a task, unless it is done."""
        if name in self.done:
            return
        work()
        self.done.append(name)
        with atomic_write(self._path) as file:
            file.write(json.dumps({"identity": self._identity, "total": self.total, "done": self.done}).encode())


def progress(folder: Path) -> tuple[int, int]:
    """How many tasks of the job in a folder are done, and how many it has, 0 if that is not known."""
    found = _read(folder / FILE)
    return (len(found["done"]), found["total"]) if found else (0, 0)


def _read(path: Path) -> dict | None:
    """None if there is none, or if it is damaged: then the job begins again."""
    try:
        found = json_object(path, LARGEST)
        assert found is not None and isinstance(found["identity"], str) and isinstance(found["total"], int)
        assert isinstance(found["done"], list) and all(isinstance(name, str) for name in found["done"])
    except (OSError, FormatError, AssertionError, KeyError):
        return None
    return found
