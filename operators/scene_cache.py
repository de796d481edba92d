"""The Gaussians of splats that are drawn again and again, until Blender says that an object's data has changed."""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon.finetune.order import morton_order
from ..svrgs_addon.scene import Scene
from . import bridge, bridge_graph

_scenes: dict[int, tuple] = {}  # session_uid of the data: what is visible of it along a Morton curve, and the rows these were


def read(obj: bpy.types.Object) -> Scene:
    """bridge_graph.visible_scene(obj) in another order: what lies together in space lies together in memory."""
    return _entry(obj)[0]


def read_values(obj: bpy.types.Object, name: str):
    """(N,) numbers of a further attribute in the order of read(obj); None where there is none."""
    values = bridge.values(obj, name)
    return None if values is None else values[_entry(obj)[1]]


def _entry(obj: bpy.types.Object) -> tuple:
    uid = obj.data.session_uid
    if uid not in _scenes:
        scene, rows = bridge.scene_from_object(obj), bridge_graph.visible_rows(obj)
        rows = rows[morton_order(scene.means[rows])]
        _scenes[uid] = scene.select(rows), rows
    return _scenes[uid]


def forget_updated(depsgraph: bpy.types.Depsgraph):
    """Drops what the last change in the graph made wrong."""
    for update in depsgraph.updates:
        changed = update.id.original
        if isinstance(changed, bpy.types.Object) and update.is_updated_geometry:
            changed = changed.data
        if changed is not None:
            _scenes.pop(changed.session_uid, None)


@persistent
def _after_update(scene, depsgraph=None):
    if depsgraph is not None:
        forget_updated(depsgraph)


@persistent
def _forget_all(*_):
    _scenes.clear()


HANDLERS = (("depsgraph_update_post", _after_update), ("load_post", _forget_all), ("undo_post", _forget_all), ("redo_post", _forget_all))


def register():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).append(handler)


def unregister():
    for event, handler in HANDLERS:
        getattr(bpy.app.handlers, event).remove(handler)
    _scenes.clear()
