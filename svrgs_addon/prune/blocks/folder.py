"""The folder of the blocks, which also holds the views."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Sequence
from pathlib import Path

from ...files.atomic import remove_abandoned
from ...scene.camera import Camera
from ...system.errors import SceneError
from ...system.file_names import remove_link
from ...views.camera_files import load_cameras
from ...views.cameras_json import write_cameras_json
from .divided import clear
from .learning import AROUND, RUNS
from .request import FILE as REQUEST
from .request import Request
from .tasks import FILE as TASKS
from .tuning import CUT, MIXED, TUNED

SCORED, MEASURED = "scored_views.json", "measured_views.json"
RESULT, LEVEL, HELD = "result", "level_{}.ply", "held"


def blocks_of(out: Path) -> Path:
    """The folder of the blocks of a job with this output, if no other is named."""
    return out.with_name(out.name + ".blocks")


def prepare(work: Path, scored: Sequence[Camera], measured: Sequence[Camera], request: Request | None = None):
    """Makes the folder, or takes that of a run that was killed, and writes the views into it, and what is
    asked of a method. Raises SceneError for a folder with other things."""
    refuse_foreign(work)
    work.mkdir(parents=True, exist_ok=True)
    write_cameras_json(work / SCORED, scored)
    write_cameras_json(work / MEASURED, measured)
    for name in (REQUEST, TASKS):
        (work / name).unlink(missing_ok=True)
    if request is not None:
        request.write(work)


def refuse_foreign(work: Path):
    """Raises SceneError for a folder with other things than blocks."""
    if work.is_dir():
        remove_abandoned(work)
    if work.exists() and not (work.is_dir() and (not any(work.iterdir()) or (work / SCORED).is_file())):
        raise SceneError(f"{work}: is not empty, and holds no blocks; name another folder with --work")


def scored_views(work: Path) -> list[Camera]:
    """The views that are scored and tuned on. Raises SplatError."""
    return load_cameras(work / SCORED)


def measured_views(work: Path) -> list[Camera]:
    """The views on which the result is measured; none where all decide. Raises SplatError."""
    path = work / MEASURED
    return [] if path.is_file() and path.read_bytes().strip() == b"[]" else load_cameras(path)


def remove_blocks(out: Path):
    """Removes the blocks of an earlier job with this output. A folder with other things stays."""
    if (work := blocks_of(out)).is_dir() and (work / SCORED).is_file():
        remove(work)


def folders(work: Path) -> list[Path]:
    """The folders in which a job writes, whether they are there or not: of scenes, and of checkpoints."""
    scenes = _scenes(work)
    runs = (found for folder in scenes for found in folder.glob(f"{RUNS}/**/"))
    return [*scenes, *(folder / HELD for folder in scenes), *runs]


def _scenes(work: Path) -> list[Path]:
    return [work / RESULT, work / AROUND, work / CUT, work / TUNED, work / MIXED, work]


def remove(work: Path):
    """Removes the files of a job, and the folder if nothing else is in it. Of a link, only the link itself is
    removed."""
    if remove_link(work):
        return
    (work / TASKS).unlink(missing_ok=True)  # first, because it says that the other files are there
    for folder in (found for found in _scenes(work) if not remove_link(found)):
        remove_abandoned(folder)
        clear(folder)
        for name in (HELD, RUNS):
            if not remove_link(folder / name):
                shutil.rmtree(folder / name, ignore_errors=True)
        levels = folder.glob(LEVEL.format("[0-9]*"))
        # SCORED last: by it, the folder is known
        for path in (folder / MEASURED, folder / REQUEST, *levels, folder / SCORED):
            path.unlink(missing_ok=True)
        with contextlib.suppress(OSError):
            folder.rmdir()
