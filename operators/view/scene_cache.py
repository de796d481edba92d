"""The Gaussians of the visible splats, kept until Blender reports that the data of an object has changed."""

from __future__ import annotations

import itertools
from dataclasses import dataclass, field, replace
from typing import Any

import bpy

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.grade import Grade, graded, inside
from ...svrgs_addon.scene.morton_order import morton_order
from ...svrgs_addon.system.errors import SplatError
from ..data import grading, known, quick_order, selection, splat_object, visible_splats

_numbers = itertools.count()


@dataclass(frozen=True)
class Entry:
    """The visible Gaussians of a splat, or all of them, sorted along a Morton curve."""

    scene: Scene
    rows: Any  # (N,) the row of each Gaussian in the object; None: it has others
    data: int  # session_uid of the object's data
    stored: Scene  # the same without the grade of the splat
    all_rows: Any  # as rows, of these
    grade: Grade
    # (N,) of attributes that were asked for, None if there is none
    values: dict[str, Any] = field(default_factory=dict)
    number: int = field(default_factory=lambda: next(_numbers))  # every entry has another number


# By session_uid of the object, the address of its evaluated data (nodes may show others beside its own, so
# these are not in data/known.py), whether it holds all Gaussians, and how many a quick result shows instead
# of its own (0: its own).
_entries: dict[tuple[int, int, bool, int], Entry] = {}


def read(obj: bpy.types.Object, whole: bool = False) -> Scene:
    """visible_splats.visible_scene(obj) of an evaluated object, sorted: Gaussians close in space are close in
    memory.

    whole: instead, all Gaussians of the object that the user has not hidden, without modifiers; it need not
    be evaluated.
    """
    return _entry(obj, whole).scene


def number(obj: bpy.types.Object, whole: bool = False) -> int:
    """A number for keys: it changes when read(obj, whole) returns another scene."""
    return _entry(obj, whole).number


def read_values(obj: bpy.types.Object, name: str):
    """(N,) values of an attribute in the order of read(obj); None if there is no such attribute."""
    entry = _entry(obj)
    if name not in entry.values:
        values = splat_object.values(obj, name) if entry.rows is not None else None
        entry.values[name] = None if values is None else values[entry.rows]
    return entry.values[name]


def read_own(obj: bpy.types.Object) -> tuple[Scene, Any]:
    """The visible Gaussians of an object itself, without its modifiers, and the row (N,) of each in it."""
    if not obj.modifiers:
        entry = _entry(obj.evaluated_get(bpy.context.evaluated_depsgraph_get()))
        if entry.rows is not None:
            return entry.scene, entry.rows
    rows = visible_splats.visible_rows(obj)
    return grading.applied(splat_object.scene_from_object(obj).select(rows), obj), rows


def _entry(obj: bpy.types.Object, whole: bool = False) -> Entry:
    other = obj.original[quick_order.SHOWN] if not whole and quick_order.is_shown(obj.original) else 0
    key = obj.original.session_uid, 0 if whole else obj.data.as_pointer(), whole, other
    grade, data = grading.of(obj), obj.original.data.session_uid
    if key not in _entries and other:
        try:
            if (shown := quick_order.shown(obj.original)) is not None:
                _entries[key] = Entry(shown, None, data, shown, None, Grade())
        except SplatError as error:  # the panel says it, and the splat's own are shown and applied
            known.of(obj.original).order_problem = str(error)
    if key not in _entries:
        obj = obj.original if whole else obj
        scene = splat_object.scene_from_object(obj)
        rows = (~selection.hidden(obj)).nonzero()[0] if whole else visible_splats.unmarked_rows(obj)
        rows = rows[morton_order(scene.means[rows])]
        scene = scene.select(rows)
        _entries[key] = Entry(scene, rows, data, scene, rows, Grade())
    if (entry := _entries[key]).grade != grade:
        left = inside(entry.stored.means, grade) > 0
        own = None if entry.all_rows is None else entry.all_rows[left]
        _entries[key] = Entry(graded(entry.stored, grade), own, data, entry.stored, entry.all_rows, grade)
    return _entries[key]


def forget_updated(depsgraph: bpy.types.Depsgraph):
    """Removes the entries of objects that have changed or are gone. Where only marks have changed, such as
    the selection, the Gaussians stay, and the marks are read again."""
    if not _entries:
        return
    there = {obj.session_uid for obj in bpy.data.objects}
    changed = {
        update.id.original.session_uid
        for update in depsgraph.updates
        if not isinstance(update.id, bpy.types.Object) or update.is_updated_geometry
    }
    for key, entry in list(_entries.items()):
        if entry.data in known.unchanged and key[0] in there:
            _entries[key] = replace(entry, values={}, number=next(_numbers))
        elif key[0] not in there or key[0] in changed or entry.data in changed:
            del _entries[key]


def _after_update(scene, depsgraph):
    forget_updated(depsgraph)


def forget(*_):
    _entries.clear()


HANDLERS = {
    "depsgraph_update_post": _after_update,
    "frame_change_post": _after_update,
    "undo_post": forget,
    "redo_post": forget,
}
