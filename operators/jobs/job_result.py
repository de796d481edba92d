"""The result of a finished job in the scene: the original, with its removed Gaussians marked, and the pruned
splat beside it.

Both store how the job ranked each Gaussian, so the slider Keep can show fewer or more at once. svrgs.apply
deletes Gaussians of the pruned splat; only svrgs.discard deletes the original.

Original and pruned splat know each other by object properties. After every change of the scene, the
properties that name a deleted partner are removed, and the original of a deleted result is shown again. Its
ranking stays, so an undo can join both again. A copy of either one stands alone.
"""

from __future__ import annotations

from functools import cached_property

import bpy
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix

from ...svrgs_addon.files.registry import read_scene
from ...svrgs_addon.jobs.job_folder import TRAIN, JobFolder
from ...svrgs_addon.prune.kept_share import (
    BOUNDARY,
    among,
    in_order,
    lowest,
    merged,
    numbered,
    place_of,
)
from ...svrgs_addon.scene.affine import transformed
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.scene.moved_points import common_motion
from ...svrgs_addon.system.errors import SceneError
from ..data import grading, known, quick_order, selection, splat_object
from ..data.job_paths import unlink
from ..data.pairs import ORIGINAL, PRUNED, join, original_of, pruned_of, set_hidden
from ..data.select import in_view_layer, select
from ..data.visible_splats import HIDE_MODIFIER, REMOVED
from ..data.world_matrix import world_matrix
from ..scene import photographs

SCORE, ROW, PROBABILITY = "svrgs:score", "svrgs:row", "svrgs:probability"  # attributes, as is REMOVED
MERGED = "svrgs_merged"  # property of a pruned splat until Apply: it has merged Gaussians, and no ranking
KEPT = "svrgs_kept"  # property of a pruned splat until Apply: the number of Gaussians that the job kept
PSNR = "svrgs_psnr"  # property of the pruned splat: dB on the test photographs before and after
OWN_PSNR = "svrgs_own_psnr"  # property of the pruned splat: dB against pictures of the original
NOTES = "svrgs_result_notes"  # property of the pruned splat until Apply: sentences on the result, a line each


def load(context, obj: bpy.types.Object, folder: JobFolder) -> bpy.types.Object:
    """Adds the result of a finished job to the scene. obj: the splat that was pruned, or the root of the
    cameras that a splat was trained from. Raises SceneError, FormatError."""
    if folder.kind == TRAIN:
        return _load_trained(context, obj, folder)
    recovered, request, result = read_scene(folder / "pruned.ply"), folder.request(), folder.result()
    if splat_object.count(obj) != request["count"]:
        text = tr(
            "'{name}' has {now:,} Gaussians, but {before:,} when the job began: undo the edit, then load the"
            " result"
        )
        now, before = splat_object.count(obj), request["count"]
        raise SceneError(text.format(name=obj.name, now=now, before=before))
    pruned = (_load_merged if folder.merged else _load_ranked)(obj, recovered, folder)
    psnr = [result[side].get("psnr") for side in ("before", "after")]
    if all(isinstance(value, float) for value in psnr):  # null if images and photographs are identical
        pruned[PSNR] = psnr
    elif isinstance(psnr[1], float):  # the photographs were pictures of the original
        pruned[OWN_PSNR] = psnr[1]
    notes, hidden = list(map(str, result.get("notes") or [])), selection.hidden_count(obj)
    if folder.merged and hidden:
        text = tr("{count:,} Gaussians that were hidden were merged with others, and are seen in the result")
        notes.append(text.format(count=hidden))
    if notes:
        pruned[NOTES] = "\n".join(notes)
    found, masks = result.get("photographs") or {}, result.get("masks") or ""
    photographs.store(splat_object.root_of(obj), found, masks)
    pruned.svrgs_share = 100 * pruned[KEPT] / request["count"]
    if context.view_layer.objects.active == obj and in_view_layer(context, pruned):
        obj.select_set(False)
        pruned.select_set(True)
        context.view_layer.objects.active = pruned
    return pruned


def _load_trained(context, root: bpy.types.Object, folder: JobFolder) -> bpy.types.Object:
    """Adds the trained splat below the root of its cameras, and selects it if something of the dataset is
    active."""
    cameras = (obj for obj in root.children if obj.type == "CAMERA" and obj.users_collection)
    collection = splat_object.collection_of(next(cameras, root))
    name, scene = f"{root.name} splat", read_scene(folder.output)
    splat = splat_object.object_from_scene(name, scene, collection, world_matrix(root))
    splat_object.parent_to_root(splat, root)
    photographs.store(root, folder.result().get("photographs") or {})
    family = {root, *root.children_recursive}
    if context.view_layer.objects.active in family and in_view_layer(context, splat):
        select(context, [splat])
    known.of(splat).result_of = str(folder.path)
    unlink(root)
    return splat


def _load_ranked(obj: bpy.types.Object, recovered: Scene, folder: JobFolder) -> bpy.types.Object:
    """Adds the pruned splat beside `obj`, marks in `obj` what the job removed, and hides it."""
    kept, score = folder.arrays()
    probability = folder.probability()
    if recovered.count != kept.sum():
        text = tr("{file}: does not belong to this job's other files")
        raise SceneError(text.format(file=folder / "pruned.ply"))
    pruned = _beside(obj, recovered, folder)
    rows = numbered(len(kept))
    for target, chosen in ((obj, slice(None)), (pruned, kept)):
        splat_object.set_values(target, SCORE, "FLOAT", score[chosen])
        splat_object.set_values(target, ROW, "INT", rows[chosen])
        if probability is not None:
            splat_object.set_values(target, PROBABILITY, "FLOAT", probability[chosen])
        _hide_removed(target)
    selection.carry_hidden(pruned, [selection.hidden(obj)[kept]])
    join(obj, pruned)
    pruned[KEPT] = int(kept.sum())
    show(pruned, pruned[KEPT])
    return pruned


def _load_merged(obj: bpy.types.Object, recovered: Scene, folder: JobFolder) -> bpy.types.Object:
    """As _load_ranked(), of a job that merged Gaussians: they have no place in a ranking of the original's,
    so nothing is marked in it."""
    pruned = _beside(obj, recovered, folder)
    join(obj, pruned)
    pruned[KEPT], pruned[MERGED], pruned[quick_order.JOB] = recovered.count, True, folder.path.name
    set_hidden(obj, True)
    set_hidden(pruned, False)
    quick_order.read_ahead(folder)
    return pruned


def _beside(obj: bpy.types.Object, recovered: Scene, folder: JobFolder) -> bpy.types.Object:
    """A copy of `obj` with the recovered Gaussians, moved as its points were since the job began. Raises
    SceneError."""
    positions = splat_object.stored_values(obj, splat_object.POSITION)
    motion = common_motion(read_scene(folder / "scene.ply").means, positions)
    if motion is None:
        text = tr("points of '{name}' were moved since the job began: undo the edit, then load the result")
        raise SceneError(text.format(name=obj.name))
    recovered = transformed(recovered, motion)
    make_room(obj)
    return splat_object.copy_with(obj, f"{obj.name} pruned", recovered)


def make_room(original: bpy.types.Object):
    """For a new result: an earlier one that was applied becomes a splat of its own, hidden; any other is
    deleted."""
    former = pruned_of(original)
    if undecided(former):
        discard_result(original)
    elif former is not None:
        former.pop(ORIGINAL, None)
        original.pop(PRUNED, None)
        set_hidden(former, True)


def settle(original: bpy.types.Object | None, pruned: bpy.types.Object):
    """After Apply: both are ordinary splats, and the pruned one is shown."""
    for obj in filter(None, (original, pruned)):
        unmark(obj)
        set_hidden(obj, obj != pruned)
    for name in (KEPT, PSNR, OWN_PSNR, NOTES, MERGED, quick_order.SHOWN, quick_order.JOB):
        pruned.pop(name, None)


def pair_of(obj: bpy.types.Object | None) -> tuple[bpy.types.Object | None, bpy.types.Object | None]:
    """(original, pruned) if the object is one of a pair; None for a missing one. If it is one of two pairs:
    that with an undecided result."""
    if obj is None:
        return None, None
    pruned, original = pruned_of(obj), original_of(obj)
    if undecided(obj) or (original is not None and not undecided(pruned)):
        return original, obj
    return (obj, pruned) if pruned is not None else (None, None)


def undecided(pruned: bpy.types.Object | None) -> bool:
    """Whether the splat is a result that was not applied yet."""
    if pruned is None or KEPT not in pruned:
        return False
    return REMOVED in pruned.data.attributes or pruned.get(MERGED, False)


def ranked(pruned: bpy.types.Object) -> bool:
    """Whether the result has a ranking of the original's Gaussians, so that fewer or more can be shown. One
    with merged Gaussians has none."""
    return not pruned.get(MERGED, False)


def has_slider(pruned: bpy.types.Object) -> bool:
    """Whether fewer or more Gaussians can be shown: by a ranking, or by the order of a quick job."""
    return ranked(pruned) or quick_order.available(pruned)


def show(pruned: bpy.types.Object, count: int):
    """Shows the `count` Gaussians with the highest rank and marks all others. Gaussians that the job had
    removed look as in the original. A result without a ranking shows so many of its order, or all of its
    own."""
    if not ranked(pruned):
        quick_order.show(pruned, count, pruned[KEPT])
        return
    original = original_of(pruned)
    score = splat_object.stored_values(original or pruned, SCORE)
    limit = lowest(score, count)
    splat_object.set_values(pruned, REMOVED, "BOOLEAN", splat_object.stored_values(pruned, SCORE) < limit)
    if original is None:
        return
    splat_object.set_values(original, REMOVED, "BOOLEAN", score < limit)
    more = bool(limit <= BOUNDARY)
    for obj, hidden in ((original, not more), (pruned, more)):
        set_hidden(obj, hidden)


def shown_count(pruned: bpy.types.Object) -> int:
    """Number of Gaussians that Apply would keep."""
    return Shown(pruned).count if ranked(pruned) else quick_order.count(pruned)


def moved_aside(original: bpy.types.Object, pruned: bpy.types.Object) -> bool:
    """Whether the result is in another place than its original."""
    moved = splat_object.relative(world_matrix(pruned), world_matrix(original))
    return Matrix(moved) != Matrix()


class Shown:
    """What is shown of a ranked result: Gaussians of the splat itself, and those of the original that its job
    had removed, as they were. Points of either may have been deleted in Edit Mode."""

    def __init__(self, pruned: bpy.types.Object):
        stored = splat_object.stored_values
        self.pruned, self.original = pruned, original_of(pruned)
        self.left = ~stored(pruned, REMOVED)
        self.back = self.left[:0]  # of the original
        if self.original is not None:
            self.back = (stored(self.original, SCORE) <= BOUNDARY) & ~stored(self.original, REMOVED)
        self.brings_back = bool(self.back.any())
        self.count = int(self.left.sum()) + int(self.back.sum())

    @cached_property
    def rows(self):
        """(n,) of the Gaussians of the splat in the original."""
        return splat_object.stored_values(self.pruned, ROW)

    @cached_property
    def rows_before(self):
        """(N,) the same of the original's own."""
        return splat_object.stored_values(self.original, ROW)

    @cached_property
    def marked(self) -> tuple:
        """(n,) and (N,) bool: the Gaussians of the splat and of the original that the user has hidden in one
        of both."""
        own = selection.hidden(self.pruned)
        if self.original is None:
            return own, own[:0]
        before = selection.hidden(self.original)
        return (own | among(self.rows, self.rows_before[before]) if before.any() else own), before

    @property
    def seen(self) -> int:
        """How many of them the user has not hidden."""
        own, before = self.marked
        return self.count - int((own & self.left).sum()) - int((before & self.back).sum())

    @property
    def hidden(self):
        """(count,) bool: those that the user has hidden."""
        own, before = self.marked
        if not self.brings_back:
            return own[self.left]
        return in_order(self.rows[self.left], own[self.left], self.rows_before[self.back], before[self.back])

    @property
    def gaussians(self) -> Scene:
        """In the original's order."""
        scene = splat_object.scene_from_object(self.pruned)
        left = scene.select(self.left)
        if not self.brings_back:
            return left
        before = splat_object.scene_from_object(self.original)
        moved = splat_object.relative(world_matrix(self.pruned), world_matrix(self.original))
        place = place_of(before.means, self.rows_before, scene.means, self.rows, moved)
        returned = transformed(before.select(self.back), place)
        return merged(left, self.rows[self.left], returned, self.rows_before[self.back])

    @property
    def seen_gaussians(self) -> Scene:
        """Those that the user has not hidden."""
        return self.gaussians if self.seen == self.count else self.gaussians.select(~self.hidden)


def apply(pruned: bpy.types.Object) -> Scene:
    """Gives the splat the Gaussians that are shown; those that the user has hidden stay hidden. Raises
    SplatError."""
    if ranked(pruned):
        shown = Shown(pruned)
        scene, hidden = shown.gaussians, [shown.hidden]
    else:
        scene, hidden = quick_order.shown(pruned) or splat_object.scene_from_object(pruned), []
    if not scene.count:
        raise SceneError(tr("no Gaussian would be left: keep more"))
    splat_object.replace_gaussians(pruned, scene)
    if hidden:
        selection.carry_hidden(pruned, hidden)
    return scene


def before_pruning(original: bpy.types.Object) -> Scene:
    """The Gaussians of the splat that a job has pruned, as it was seen before."""
    whole, hidden = splat_object.scene_from_object(original), selection.hidden(original)
    return grading.applied(whole.select(~hidden) if hidden.any() else whole, original)


def unmark(obj: bpy.types.Object):
    """Makes the object an ordinary splat again, with all its Gaussians shown."""
    splat_object.remove_values(obj, REMOVED, SCORE, ROW, PROBABILITY)
    _show_removed(obj)


def _show_removed(obj: bpy.types.Object):
    if HIDE_MODIFIER in obj.modifiers:
        obj.modifiers.remove(obj.modifiers[HIDE_MODIFIER])


def discard_result(original: bpy.types.Object):
    """Deletes the result. The original is as it was before the job."""
    pruned = pruned_of(original)
    unmark(original)
    set_hidden(original, False)
    original.pop(PRUNED, None)
    if pruned is not None:
        splat_object.delete(pruned)


def discard_original(original: bpy.types.Object, pruned: bpy.types.Object):
    """Deletes the original of an applied result. If it was itself pruned from another splat, that one becomes
    the original."""
    first = original_of(original)
    splat_object.delete(original)
    if first is not None:
        join(first, pruned)


def _hide_removed(obj: bpy.types.Object):
    if HIDE_MODIFIER not in obj.modifiers:
        nodes = bpy.data.node_groups.get(HIDE_MODIFIER) or _hide_nodes()
        obj.modifiers.new(HIDE_MODIFIER, "NODES").node_group = nodes


def _hide_nodes() -> bpy.types.NodeTree:
    """A new node group that deletes the points marked as removed."""
    group = bpy.data.node_groups.new(HIDE_MODIFIER, "GeometryNodeTree")
    for direction in ("INPUT", "OUTPUT"):
        group.interface.new_socket("Geometry", in_out=direction, socket_type="NodeSocketGeometry")
    nodes = group.nodes
    given, out = nodes.new("NodeGroupInput"), nodes.new("NodeGroupOutput")
    marked = nodes.new("GeometryNodeInputNamedAttribute")
    delete = nodes.new("GeometryNodeDeleteGeometry")
    marked.data_type, delete.domain = "BOOLEAN", "POINT"
    marked.inputs["Name"].default_value = REMOVED
    attribute = next(socket for socket in marked.outputs if socket.enabled and socket.name == "Attribute")
    for place, node in enumerate((given, marked, delete, out)):
        node.location = 200 * place, 0
    group.links.new(given.outputs[0], delete.inputs["Geometry"])
    group.links.new(attribute, delete.inputs["Selection"])
    group.links.new(delete.outputs[0], out.inputs[0])
    return group


# --- after the user deletes, copies or undoes


def _after_update(scene, *_):
    """Checks all pairs: see the top of this file."""
    for obj in scene.objects:
        if PRUNED in obj and not obj.library:
            _check_original(obj)
        if ORIGINAL in obj and not obj.library:
            _check_pruned(obj)


def _check_original(obj: bpy.types.Object):
    pruned = pruned_of(obj)
    owner = original_of(pruned) if pruned is not None else None
    if pruned is None:
        _free_original(obj)
    elif owner is None:
        pruned[ORIGINAL] = obj
    elif owner != obj:  # a copy
        _free_original(obj, owner.data)


def _check_pruned(obj: bpy.types.Object):
    original = original_of(obj)
    if original is None or pruned_of(original) not in (None, obj):
        del obj[ORIGINAL]
    elif undecided(obj) and pruned_of(original) is None:
        _rejoin(original, obj)


def _free_original(original: bpy.types.Object, shared=None):
    """Makes the original independent and shows it. Its ranking stays, for an undo. shared: data whose marks
    another object needs."""
    del original[PRUNED]
    if original.data != shared:
        splat_object.remove_values(original, REMOVED)
    _show_removed(original)
    set_hidden(original, False)


def _rejoin(original: bpy.types.Object, pruned: bpy.types.Object):
    """Joins a pair again after an undo."""
    if not ranked(pruned):
        original[PRUNED] = pruned
        set_hidden(original, True)
        return
    score = splat_object.values(original, SCORE)
    if score is None or (score > BOUNDARY).sum() != pruned[KEPT]:  # the original has been edited since
        del pruned[ORIGINAL]
        return
    original[PRUNED] = pruned
    _hide_removed(original)
    show(pruned, round(pruned.svrgs_share / 100 * splat_object.count(original)))


HANDLERS = {"depsgraph_update_post": _after_update}
