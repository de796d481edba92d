"""What this session knows of each splat besides what the file stores.

Entries are kept by session_uid, which undo does not change. Those of an object stay until another file is
opened; those of its data until Blender changes that data, and until an undo.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import bpy
from bpy.app.handlers import persistent


@dataclass
class KnownObject:
    """Of a splat, or of the root of cameras."""

    job: str = ""  # the folder of its job
    result_of: str = ""  # the folder of the finished job whose result it is; see jobs/applied_jobs.py
    # the last estimate, {"busy": True} until it is there; and what it depends on
    estimate: dict[str, Any] = field(default_factory=dict)
    estimated: dict[str, Any] = field(default_factory=dict)
    placing: bool = False  # cameras are being placed for it
    placed: dict[str, Any] | None = None  # what came of that, until it is shown
    problem: str = ""  # why no cameras were placed


@dataclass
class KnownData:
    """Of the points of a splat."""

    moved: int | None = None  # Gaussians whose points were moved without their shapes
    digest: str = ""  # digest_of() its Gaussians


objects: dict[int, KnownObject] = {}
_data: dict[int, KnownData] = {}


def of(obj: bpy.types.Object) -> KnownObject:
    """What is known of the object; to be changed by the caller."""
    return of_uid(obj.session_uid)


def of_uid(uid: int) -> KnownObject:
    """As of(), by the session_uid: for threads, which must not use bpy."""
    return objects.setdefault(uid, KnownObject())


def of_data(obj: bpy.types.Object) -> KnownData:
    """What is known of the points that the object has now."""
    return _data.setdefault(obj.data.session_uid, KnownData())


def forget_points():
    """Forgets what is known of the points of all splats."""
    _data.clear()


@persistent
def _after_update(scene, depsgraph=None):
    for update in depsgraph.updates if depsgraph is not None and _data else ():
        changed = update.id.original
        if isinstance(changed, bpy.types.Object):
            changed = changed.data if update.is_updated_geometry else None
        _data.pop(getattr(changed, "session_uid", 0), None)


@persistent
def _after_undo(*_):
    forget_points()


@persistent
def _after_load(*_):
    objects.clear()
    forget_points()


HANDLERS = {
    "depsgraph_update_post": _after_update,
    "undo_post": _after_undo,
    "redo_post": _after_undo,
    "load_post": _after_load,
}


def unregister():
    _after_load()
