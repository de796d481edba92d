"""Where the files of a splat's job are. The .blend file stores only the path of their folder, as a property
of the splat."""

from __future__ import annotations

import os

import bpy

FOLDER = "svrgs_job"  # property of a splat
JOBS_FOLDER = "//svrgs_jobs"  # folder of jobs next to the .blend file


def folder_of(obj: bpy.types.Object | None) -> str:
    """The folder of the splat's job: where it was started, or next to the .blend file if both were moved;
    empty: no job."""
    path = obj.get(FOLDER) if obj is not None else None
    if obj is None or not isinstance(path, str) or not path:
        return ""
    path = os.path.normpath(bpy.path.abspath(path, library=obj.library))
    moved = (
        os.path.normpath(bpy.path.abspath(f"{JOBS_FOLDER}/{os.path.basename(path)}"))
        if bpy.data.filepath
        else path
    )
    return moved if not os.path.exists(path) and os.path.exists(moved) else path
