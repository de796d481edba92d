"""kill -9 at random moments, of every writer here and of a job of every recipe (jobs.py), which also meets a
full disk and too little memory.

Children are forked from a process that has everything imported, so that each costs no start; it must never
have used the native library itself, whose threads a fork does not take along.
"""

from __future__ import annotations

import hashlib
import os
import random
import re
import signal
import time
import traceback
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svrgs_addon.files.atomic import write_array, write_arrays
from svrgs_addon.files.images import write_image
from svrgs_addon.files.ply import write_ply
from svrgs_addon.jobs.job_folder import JobFolder
from svrgs_addon.scene.gaussians import Scene


@dataclass
class Survived:
    """How it went."""

    kills: int = 0
    # runs that came to their end, or writers that had replaced the file when they were killed
    finished: int = 0
    resumed: int = 0  # starts from a checkpoint


def forked(work: Callable[[], object]) -> int:
    """A child that does the work and nothing else; its process id."""
    child = os.fork()
    if child:
        return child
    status = 1
    try:
        work()
        status = 0
    except Exception:
        traceback.print_exc()
    finally:
        os._exit(status)


def done(work: Callable[[], object]):
    """The work in a child, to its end."""
    assert os.waitpid(forked(work), 0)[1] == 0


def killed(work: Callable[[], object], seconds: float) -> int | None:
    """The work in a child that is killed after so many seconds; its exit status if it ended before, else
    None."""
    child, end = forked(work), time.monotonic() + seconds
    while time.monotonic() < end:
        if (found := os.waitpid(child, os.WNOHANG))[0]:
            return os.waitstatus_to_exitcode(found[1])
        time.sleep(0.0005)
    os.kill(child, signal.SIGKILL)
    code = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
    return None if code == -signal.SIGKILL else code


def digest(path: Path) -> str:
    """Of the bytes, without the time that an EXR says it was made."""
    return hashlib.sha256(
        re.sub(rb"capDate\0string\0.{4}[0-9: ]{19}", b"", path.read_bytes(), flags=re.DOTALL)
    ).hexdigest()


# --- writers


def scene_of(count: int, value: float) -> Scene:
    full = lambda *shape: np.full((count, *shape), value, np.float32)
    return Scene(full(3), full(3), full(4), full(), full(4, 3))


def write_npz(path: Path, version: int):
    write_arrays(path, {"a": np.full(100_000, version), "b": np.full((3, 50_000), version, np.float32)})


WRITERS: dict[str, Callable[[Path, int], object]] = {
    "scene.ply": lambda path, version: write_ply(path, scene_of(20_000, version)),
    "view.png": lambda path, version: write_image(
        path, np.full((300, 400, 3), 0.25 + version / 2, np.float32)
    ),
    "view.exr": lambda path, version: write_image(
        path, np.full((300, 400, 3), 0.25 + version / 2, np.float32)
    ),
    "array.npy": lambda path, version: write_array(path, np.full(200_000, version)),
    "arrays.npz": write_npz,
    "state.json": lambda path, version: JobFolder(path.parent).write_json(
        path.name, {"version": version, "text": "x" * 50_000}
    ),
}


def kill_writer(name: str, folder: Path, kills: int, seed: int = 0) -> Survived:
    """A file that is written over and over, its two contents in turn: whenever the writer dies, one of them
    is there, whole."""
    chance, survived, path, write = random.Random(seed), Survived(), folder / name, WRITERS[name]
    contents = []
    for version in (1, 0):
        began = time.monotonic()
        done(lambda: write(path, version))  # noqa: B023
        contents.append(digest(path))
    duration = time.monotonic() - began

    def forever():
        version = 1
        while True:
            write(path, version)
            version = 1 - version

    for _ in range(kills):
        assert killed(forever, chance.uniform(0, 3 * duration)) is None
        assert digest(path) in contents, f"{name} is neither the old nor the new file"
        survived.kills += 1
        survived.finished += digest(path) == contents[0]
    return survived
