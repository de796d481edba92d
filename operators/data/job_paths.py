"""Which folder holds the job of a splat, or of the root of cameras.

The .blend file stores only the path of this folder, as a property of the object. Undo may remove the
property, and a copy of the splat has it too. So known.py remembers which splat has which folder: after an
undo the property is put back, and it is removed from a copy.
"""

from __future__ import annotations

import datetime
import os
import re
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.system.errors import SplatError
from . import known
from .extension import PACKAGE

FOLDER = "svrgs_job"  # property of a splat
JOBS_FOLDER = "//svrgs_jobs"  # folder of jobs next to the .blend file


def folder_of(obj: bpy.types.Object | None) -> str:
    """The folder of the splat's job: where it was started, or next to the .blend file if both were moved;
    empty: no job."""
    path = obj.get(FOLDER) if obj is not None else None
    if obj is None or not isinstance(path, str) or not path:
        return ""
    path = os.path.normpath(bpy.path.abspath(path, library=obj.library))
    if os.path.exists(path) or not bpy.data.filepath:
        return path
    moved = os.path.normpath(bpy.path.abspath(f"{JOBS_FOLDER}/{os.path.basename(path)}"))
    return moved if os.path.exists(moved) else path


def owners() -> dict[str, bpy.types.Object]:
    """The splats and roots in the file that have a job, by its folder."""
    return {folder: obj for obj in bpy.data.objects if obj.users_collection and (folder := folder_of(obj))}


def link(obj: bpy.types.Object, folder: str):
    """Gives the splat the job in this folder."""
    obj[FOLDER] = known.of(obj).job = folder


def unlink(obj: bpy.types.Object):
    """Takes the splat's job away."""
    obj.pop(FOLDER, None)
    known.of(obj).job = ""


def job_folders(context) -> list[str]:
    """The folders in which jobs are made: the chosen one, that next to the .blend file, that of the
    extension. The first is for new jobs."""
    chosen = bpy.path.abspath(context.scene.svrgs_prune.folder)
    beside = bpy.path.abspath(JOBS_FOLDER) if bpy.data.filepath else ""
    own = bpy.utils.extension_path_user(PACKAGE, path="jobs", create=False)
    return [os.path.normpath(folder) for folder in (chosen, beside, own) if folder]


def absolute(path: str) -> str:
    """The absolute path; empty stays empty. Raises SplatError for a path that begins with // while the .blend
    is not saved."""
    if path.startswith("//") and not bpy.data.filepath:
        text = tr(
            "{path}: begins at the folder of the .blend, which has not been saved; save it, or give the"
            " whole path"
        )
        raise SplatError(text.format(path=path))
    return os.path.abspath(bpy.path.abspath(path)) if path else ""


def new_folder(context, name: str) -> Path:
    """The folder of a new job of a splat or root with this name. Raises SplatError."""
    absolute(context.scene.svrgs_prune.folder)
    stamp = datetime.datetime.now().strftime("%Y%m%d-%H%M%S-%f")
    return Path(job_folders(context)[0]) / f"{re.sub('[^0-9A-Za-z_-]+', '_', name)[:40]}-{stamp}"


def _after_undo(*_):
    """Gives splats back the jobs that they had before the undo."""
    for obj in bpy.data.objects:
        folder = known.of(obj).job
        if folder and folder_of(obj) != folder:
            obj[FOLDER] = folder


def _after_update(scene, *_):
    """Takes the job away from a copy of a splat. A splat that was loaded or appended with its job keeps
    it."""
    for obj in scene.objects:
        folder = folder_of(obj)
        if folder and not obj.library and known.of(obj).job != folder:
            if any(known.of(other).job == folder and other.users_collection for other in bpy.data.objects):
                del obj[FOLDER]
            else:
                known.of(obj).job = folder


HANDLERS = {"undo_post": _after_undo, "redo_post": _after_undo, "depsgraph_update_post": _after_update}
