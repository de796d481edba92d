"""What this session knows of each splat and of each scene besides what the file stores.

Entries are kept by session_uid, which undo does not change. Those of an object or a scene stay until another
file is opened; those of an object's data until Blender changes that data, and until an undo.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

import bpy


@dataclass
class KnownObject:
    """Of a splat, or of the root of cameras."""

    job: str = ""  # the folder of its job
    result_of: str = ""  # the folder of the finished job whose result it is; see jobs/apply.py
    # what the last estimate depends on, and the estimate, {"busy": True} until it is there
    estimate: tuple[dict[str, Any], dict[str, Any]] = ({}, {})
    import_problems: list[str] = field(default_factory=list)  # what the last import of cameras below it lacks
    # what the check of its photographs depends on, and what is wrong; '' until that is known
    cameras_checked: tuple[Any, str] = ((), "")
    placing: bool = False  # cameras are being placed for it
    placing_problem: str = ""  # why none were placed
    mask_problem: str = ""  # why the mask of the photograph that is looked at cannot be shown
    order_problem: str = ""  # why other numbers of Gaussians of this quick result cannot be shown


@dataclass
class KnownData:
    """Of the points of a splat."""

    moved: int | None = None  # Gaussians whose points were moved without their shapes
    digest: str = ""  # digest_of() its Gaussians
    # what an export says on its size, by number of Gaussians, format and quantise
    sizes: dict[tuple, str] = field(default_factory=dict)


@dataclass
class KnownScene:
    """Of a scene."""

    camera: int | None = None  # session_uid of its last camera, 0: none; None: not known yet
    size: tuple[int, int] = (0, 0)  # of its renders, then
    chosen_size: tuple[int, int] = (0, 0)  # that was set together with a camera
    mask_inputs: tuple = ()  # what its last spatial mask depends on
    mask: tuple[Any, dict] | None = None  # that mask (H, W), and its figures
    changed_layer: str = ""  # the view layer that changed last, until the mask has followed
    dither: float | None = None  # its own dither while it is rendered without


unchanged: set[int] = set()  # session_uids of data whose Gaussians do not change in the update that runs
objects: dict[int, KnownObject] = {}
_data: dict[int, KnownData] = {}
_scenes: dict[int, KnownScene] = {}


def of(obj: bpy.types.Object) -> KnownObject:
    """What is known of the object; to be changed by the caller."""
    return of_uid(obj.session_uid)


def of_uid(uid: int) -> KnownObject:
    """As of(), by the session_uid: of an object that may be gone."""
    return objects.setdefault(uid, KnownObject())


def of_data(obj: bpy.types.Object) -> KnownData:
    """What is known of the points that the object has now."""
    return _data.setdefault(obj.data.session_uid, KnownData())


def of_scene(scene: bpy.types.Scene) -> KnownScene:
    """What is known of the scene; to be changed by the caller."""
    return _scenes.setdefault(scene.session_uid, KnownScene())


@contextmanager
def only_marks(obj: bpy.types.Object) -> Iterator[None]:
    """Inside this block only marks of the splat change, such as its selection. Its Gaussians do not, so what
    is known of them stays. Changes from before the block are handled first."""
    layer, uid = bpy.context.view_layer, obj.data.session_uid
    layer.update()
    unchanged.add(uid)
    try:
        yield
        layer.update()
    finally:
        unchanged.discard(uid)


def forget_points():
    """Forgets what is known of the points of all splats."""
    _data.clear()


def _after_update(scene, depsgraph):
    for update in depsgraph.updates if _data else ():
        changed = update.id.original
        if isinstance(changed, bpy.types.Object):
            changed = changed.data if update.is_updated_geometry else None
        if (uid := getattr(changed, "session_uid", 0)) not in unchanged:
            _data.pop(uid, None)


def _after_undo(*_):
    forget_points()
    for obj in objects.values():
        obj.order_problem = ""  # points may be where they were


def forget(*_):
    objects.clear()
    _scenes.clear()
    forget_points()


HANDLERS = {"depsgraph_update_post": _after_update, "undo_post": _after_undo, "redo_post": _after_undo}
