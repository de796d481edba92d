"""A finished job in the scene: the original with a mark on what pruning removes, beside it the Gaussians that were recovered.

Both know how the job ranked each Gaussian, so that fewer or more of them can be shown at once; nothing is deleted before
svrgs.apply, and the original not before svrgs.discard.
"""

from __future__ import annotations

import bpy
from bpy.app.handlers import persistent

from ..svrgs_addon.errors import SceneError
from ..svrgs_addon.files.registry import read_scene
from ..svrgs_addon.jobs.job_folder import JobFolder
from ..svrgs_addon.jobs.kept_share import BOUNDARY, lowest, merged, numbered
from ..svrgs_addon.scene import Scene
from . import bridge
from .bridge_graph import REMOVED

SCORE, ROW, PROBABILITY = "svrgs:score", "svrgs:row", "svrgs:probability"  # attributes, as is REMOVED
ORIGINAL, PRUNED, KEPT = "svrgs_original", "svrgs_pruned", "svrgs_kept"  # properties of objects: the other one; how many the job kept
PSNR = "svrgs_psnr"  # property of the pruned one: dB before and after, over the test photographs
HIDER = "SVR-GS Removed"  # the modifier that leaves out what is marked, and its node group


def load(context, obj: bpy.types.Object, folder: JobFolder) -> bpy.types.Object:
    """Adds the pruned splat beside `obj`, hides that and marks what the job dropped. Raises SceneError, FormatError."""
    kept, score = folder.arrays()
    probability = folder.probability()
    recovered = read_scene(folder / "pruned.ply")
    if recovered.count != kept.sum():
        raise SceneError(f"{folder / 'pruned.ply'}: does not belong to this job's other files")
    if bridge.count(obj) != len(kept):
        raise SceneError(f"'{obj.name}' has {bridge.count(obj):,} Gaussians, but {len(kept):,} when the job began: undo the edit, then load the result")
    if pruned_of(obj) is not None:
        forget(obj)
    pruned = bridge.object_from_scene(f"{obj.name} pruned", recovered, obj.users_collection[0], obj.matrix_world)
    pruned.parent, pruned.matrix_parent_inverse, pruned.matrix_basis = obj.parent, obj.matrix_parent_inverse, obj.matrix_basis
    rows = numbered(len(kept))
    for target, chosen in ((obj, slice(None)), (pruned, kept)):
        bridge.set_values(target, SCORE, "FLOAT", score[chosen])
        bridge.set_values(target, ROW, "INT", rows[chosen])
        if probability is not None:
            bridge.set_values(target, PROBABILITY, "FLOAT", probability[chosen])
        _hide_removed(target)
    join(obj, pruned)
    show(pruned, int(kept.sum()))
    return pruned


def join(original: bpy.types.Object, pruned: bpy.types.Object):
    """Makes each know the other."""
    original[PRUNED], pruned[ORIGINAL], pruned[KEPT] = pruned, original, bridge.count(pruned)


def pair_of(obj: bpy.types.Object | None) -> tuple[bpy.types.Object | None, bpy.types.Object | None]:
    """(original, pruned) that the object is one of; None for what there is not."""
    if obj is None:
        return None, None
    if KEPT in obj and (original_of(obj) is not None or undecided(obj)):
        return original_of(obj), obj
    pruned = pruned_of(obj)
    return (obj, pruned) if pruned is not None else (None, None)


def pruned_of(obj: bpy.types.Object) -> bpy.types.Object | None:
    """The splat that a job made of this one, if it is still in the file."""
    return _in_file(obj.get(PRUNED))


def original_of(pruned: bpy.types.Object) -> bpy.types.Object | None:
    """The splat that this one was pruned from, if it is still in the file."""
    return _in_file(pruned.get(ORIGINAL))


def _in_file(obj: bpy.types.Object | None) -> bpy.types.Object | None:
    """None for what was deleted and lives on as a pointer alone."""
    return obj if obj is not None and obj.users_collection else None


def undecided(pruned: bpy.types.Object | None) -> bool:
    """Whether the result still shows fewer or more as one likes."""
    return pruned is not None and REMOVED in pruned.data.attributes


def show(pruned: bpy.types.Object, count: int):
    """Marks all but the `count` Gaussians that rank highest. What the job had dropped is shown as it was, not recovered."""
    original = original_of(pruned)
    score = bridge.values(original or pruned, SCORE)
    limit = lowest(score, count)
    bridge.set_values(pruned, REMOVED, "BOOLEAN", bridge.values(pruned, SCORE) < limit)
    if original is None:
        return
    bridge.set_values(original, REMOVED, "BOOLEAN", score < limit)
    more = bool(limit <= BOUNDARY)
    for obj, hidden in ((original, not more), (pruned, more)):
        obj.hide_viewport = obj.hide_render = hidden


def marked_count(obj: bpy.types.Object) -> int:
    """Gaussians of the splat that are marked as removed."""
    removed = bridge.values(obj, REMOVED)
    return 0 if removed is None else int(removed.sum())


def shown_count(pruned: bpy.types.Object) -> int:
    """Gaussians that Apply would leave."""
    original = original_of(pruned)
    return int((~bridge.values(original or pruned, REMOVED)).sum())


def chosen(pruned: bpy.types.Object) -> Scene:
    """What is not marked, in the source's order: recovered, or as in the original where the job had dropped it."""
    original, scene = original_of(pruned), bridge.scene_from_object(pruned)
    left = ~bridge.values(pruned, REMOVED)
    rows, scene = bridge.values(pruned, ROW)[left], scene.select(left)
    if original is None:
        return scene
    back = ~bridge.values(original, REMOVED) & (bridge.values(original, SCORE) <= BOUNDARY)
    if not back.any():
        return scene
    return merged(scene, rows, bridge.scene_from_object(original).select(back), bridge.values(original, ROW)[back])


def unmark(obj: bpy.types.Object):
    """Makes the object an ordinary splat again, seen as a whole."""
    bridge.forget_values(obj, REMOVED, SCORE, ROW, PROBABILITY)
    _show_removed(obj)


def _show_removed(obj: bpy.types.Object):
    if HIDER in obj.modifiers:
        obj.modifiers.remove(obj.modifiers[HIDER])


def forget(original: bpy.types.Object):
    """Takes the result out of the scene; the original is as it was."""
    pruned = pruned_of(original)
    unmark(original)
    original.hide_viewport = original.hide_render = False
    original.pop(PRUNED, None)
    if pruned is not None:
        remove(pruned)


def remove(obj: bpy.types.Object):
    """Removes the object and its Gaussians from the file."""
    data = obj.data
    bpy.data.objects.remove(obj)
    if not data.users:
        getattr(bpy.data, "meshes" if isinstance(data, bpy.types.Mesh) else "pointclouds").remove(data)


def _hide_removed(obj: bpy.types.Object):
    if HIDER not in obj.modifiers:
        obj.modifiers.new(HIDER, "NODES").node_group = bpy.data.node_groups.get(HIDER) or _hider()


def _hider() -> bpy.types.NodeTree:
    """Geometry nodes that delete the points marked as removed."""
    group = bpy.data.node_groups.new(HIDER, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    nodes = group.nodes
    given, marked, delete, out = (
        nodes.new(kind) for kind in ("NodeGroupInput", "GeometryNodeInputNamedAttribute", "GeometryNodeDeleteGeometry", "NodeGroupOutput")
    )
    marked.data_type, delete.domain = "BOOLEAN", "POINT"
    marked.inputs["Name"].default_value = REMOVED
    attribute = next(socket for socket in marked.outputs if socket.enabled and socket.name == "Attribute")
    for place, node in enumerate((given, marked, delete, out)):
        node.location = 200 * place, 0
    group.links.new(given.outputs[0], delete.inputs["Geometry"])
    group.links.new(attribute, delete.inputs["Selection"])
    group.links.new(delete.outputs[0], out.inputs[0])
    return group


# --- what the user deletes, brings back and copies


@persistent
def _after_update(scene, *_):
    """A result that was deleted leaves its original visible and free; what undo brings back is joined again; a copy stands alone."""
    for obj in scene.objects:
        if PRUNED in obj and not obj.library:
            _look_at_original(obj)
        if ORIGINAL in obj and not obj.library:
            _look_at_pruned(obj)


def _look_at_original(obj: bpy.types.Object):
    pruned = pruned_of(obj)
    owner = original_of(pruned) if pruned is not None else None
    if pruned is None:
        _release(obj)
    elif owner is None:
        pruned[ORIGINAL] = obj
    elif owner != obj:  # a copy
        _release(obj, owner.data)


def _look_at_pruned(obj: bpy.types.Object):
    original = original_of(obj)
    if original is None or pruned_of(original) not in (None, obj):
        del obj[ORIGINAL]
    elif undecided(obj) and pruned_of(original) is None:
        _take_back(original, obj)


def _release(original: bpy.types.Object, others=None):
    """The ranking stays with the original, so that undo can take this back. others: data whose marks are still needed."""
    del original[PRUNED]
    if original.data != others:
        bridge.forget_values(original, REMOVED)
    _show_removed(original)
    original.hide_viewport = original.hide_render = False


def _take_back(original: bpy.types.Object, pruned: bpy.types.Object):
    score = bridge.values(original, SCORE)
    if score is None or (score > BOUNDARY).sum() != pruned[KEPT]:  # it has been edited meanwhile
        del pruned[ORIGINAL]
        return
    original[PRUNED] = pruned
    _hide_removed(original)
    show(pruned, round(pruned.svrgs_share / 100 * bridge.count(original)))


def register():
    bpy.app.handlers.depsgraph_update_post.append(_after_update)


def unregister():
    bpy.app.handlers.depsgraph_update_post.remove(_after_update)
