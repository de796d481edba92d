"""The selection of a splat: a mask of its Gaussians as an attribute, and the objects that bound a box or a
sphere.

Blender's own selection in Edit Mode, of a point cloud or of the vertices of a mesh, is written together with
the attribute.
"""

from __future__ import annotations

from collections.abc import Callable

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.prune.selection.options import Criteria
from ...svrgs_addon.prune.selection.select import selected
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.neighbours import nearest_rows
from ...svrgs_addon.system.errors import SceneError
from . import grading, known, splat_object, visible_splats
from .world_matrix import volume_matrix

SELECTED = "svrgs:selected"  # attribute: marks the selected Gaussians
OWN = "svrgs:"  # how the names of attributes of this extension begin
NEIGHBOURS = 8  # by which a selection grows or shrinks
EDIT_MODE = ".selection"  # Blender's attribute of a point cloud in Edit Mode
UNIT_BOX, UNIT_SPHERE = (-1.0, -1.0, -1.0, 1.0, 1.0, 1.0), (0.0, 0.0, 0.0, 1.0)
COMBINED = {  # SET takes the mask alone
    "EXTEND": lambda before, mask: before | mask,
    "SUBTRACT": lambda before, mask: before & ~mask,
    "INTERSECT": lambda before, mask: before & mask,
}

# the views of a splat, in its coordinates; the word as in prune/selection/select.py
Views = Callable[[visible_splats.PlacedScene, str], list[Camera]]


def find(
    obj: bpy.types.Object, wanted: Criteria, views: Views, volume: bpy.types.Object | None
) -> np.ndarray:
    """(N,) bool: the Gaussians of the splat that fulfil the criteria, as they are seen: with its grade, and
    without those that are hidden.

    wanted: lengths in Blender's units; its box or sphere is UNIT_BOX or UNIT_SPHERE, which `volume` places.
    Raises SplatError, NativeError.
    """
    rows = visible_splats.visible_rows(obj)
    seen = grading.applied(splat_object.scene_from_object(obj).select(rows), obj)
    placed = visible_splats.placed([(seen, obj.matrix_world.copy())])
    matrix = None
    if volume is not None:
        matrix = np.linalg.solve(volume_matrix(volume), np.array(placed.matrix, np.float64))
    if wanted.size is not None:
        wanted = Criteria(size=(wanted.size[0] / placed.unit, wanted.size[1] / placed.unit))
    found = selected(placed.scene, wanted, lambda named: views(placed, named), matrix)
    return splat_object.mask_of(obj, rows[found])


def found_in_edit_mode(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the Gaussians whose points are selected in Edit Mode, without those that are hidden."""
    if obj.type == "MESH":
        mask = np.zeros(splat_object.count(obj), bool)
        obj.data.vertices.foreach_get("select", mask)
    else:
        found = splat_object.values(obj, EDIT_MODE)
        mask = np.ones(splat_object.count(obj), bool) if found is None else found.astype(bool)
    return mask & ~visible_splats.marked(obj)


def change(obj: bpy.types.Object, mask: np.ndarray, mode: str, invert: bool = False) -> int:
    """Combines a mask (N,) with the selection of the splat, as COMBINED defines. Returns the number of
    selected Gaussians.

    invert: take the Gaussians that the mask does not mark, without hidden ones.
    """
    if invert:
        shown = np.zeros(len(mask), bool)
        shown[visible_splats.visible_rows(obj)] = True
        mask = shown & ~mask
    mask = mask if mode == "SET" else COMBINED[mode](read(obj), mask)
    with known.only_marks(obj):
        splat_object.set_values(obj, SELECTED, "BOOLEAN", mask)
        if obj.type == "MESH":
            obj.data.vertices.foreach_set("select", mask)
        else:
            splat_object.set_values(obj, EDIT_MODE, "BOOLEAN", mask)
    return int(mask.sum())


def read(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the selection of the splat."""
    return _marked(obj, SELECTED)


def _marked(obj: bpy.types.Object, name: str) -> np.ndarray:
    """(N,) bool: the Gaussians that an attribute marks; none without it."""
    values = splat_object.values(obj, name)
    return np.zeros(splat_object.count(obj), bool) if values is None else values.astype(bool)


def grown(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the selection, and the Gaussians nearest to each selected one."""
    mask, (rows, near) = read(obj), _nearest(obj)
    mask[rows[near[mask[rows]]].ravel()] = True
    return mask


def shrunk(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the selected Gaussians to which the nearest ones are all selected."""
    mask, (rows, near) = read(obj), _nearest(obj)
    mask[rows] &= mask[rows[near]].all(axis=1)
    return mask


def _nearest(obj: bpy.types.Object) -> tuple[np.ndarray, np.ndarray]:
    """The rows (M,) of the Gaussians that are not hidden, and which of these are nearest to each,
    (M, NEIGHBOURS)."""
    rows, means = visible_splats.visible_rows(obj), splat_object.stored_values(obj, splat_object.POSITION)
    rows = rows[np.isfinite(means[rows]).all(axis=1)]
    if len(rows) <= NEIGHBOURS:
        return rows, np.empty((len(rows), 0), np.int64)
    return rows, nearest_rows(means[rows], NEIGHBOURS)


def selected_count(obj: bpy.types.Object) -> int:
    """Number of selected Gaussians; 0 in Edit Mode, where Blender keeps those of a mesh apart."""
    return int(read(obj).sum()) if obj.mode != "EDIT" and SELECTED in obj.data.attributes else 0


def clear(obj: bpy.types.Object):
    """Selects no Gaussian."""
    change(obj, np.zeros(splat_object.count(obj), bool), "SET")
    splat_object.remove_values(obj, SELECTED)


def hide(obj: bpy.types.Object) -> int:
    """Hides the selected Gaussians from views, pictures and files, and clears the selection. Returns how many
    they are. Raises SceneError if none would be left."""
    mask = read(obj)
    _refuse_nothing(~(mask | visible_splats.marked(obj)))
    splat_object.set_values(obj, visible_splats.HIDDEN, "BOOLEAN", mask | hidden(obj))
    clear(obj)
    return int(mask.sum())


def hidden_count(obj: bpy.types.Object) -> int:
    """Number of Gaussians that hide() has hidden."""
    return int(hidden(obj).sum()) if visible_splats.HIDDEN in obj.data.attributes else 0


def carry_hidden(obj: bpy.types.Object, parts: list[np.ndarray]):
    """Hides the Gaussians that are marked in the parts (M,) bool of a splat, which follow each other."""
    mask = np.concatenate(parts)
    if mask.any():
        splat_object.set_values(obj, visible_splats.HIDDEN, "BOOLEAN", mask)


def carry_further(obj: bpy.types.Object, parts: list[list[tuple[str, str, np.ndarray]]]) -> list[str]:
    """Gives a splat the attributes that it lacks and that all parts have, which follow each other: as of
    splat_object.further_values(). Returns the names of those that some parts have. Those of this extension
    are left out: they are of one splat."""
    kinds = [{(n, kind): values for n, kind, values in part if not n.startswith(OWN)} for part in parts]
    everywhere = set.intersection(*map(set, kinds))
    for name, kind in sorted(everywhere):
        if name not in obj.data.attributes:
            joined = np.concatenate([part[name, kind] for part in kinds])
            splat_object.set_values(obj, name, kind, joined)
    named = {name for part in kinds for name, _ in part}
    return sorted(name for name in named if name not in obj.data.attributes)


def hidden(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the Gaussians that hide() has hidden."""
    return _marked(obj, visible_splats.HIDDEN)


def show_all(obj: bpy.types.Object):
    """Shows the Gaussians that hide() has hidden."""
    splat_object.remove_values(obj, visible_splats.HIDDEN)


def delete(obj: bpy.types.Object, others: bool):
    """Deletes the selected Gaussians, or all others but those that hide() has hidden, and clears the
    selection. Raises SceneError if none would be left."""
    keep(obj, read(obj) | hidden(obj) if others else ~read(obj))


def keep(obj: bpy.types.Object, left: np.ndarray):
    """Deletes the Gaussians that a mask (N,) bool does not mark, and clears the selection. Raises SceneError
    if none would be left."""
    _refuse_nothing(left)
    clear(obj)
    further = splat_object.further_values(obj)
    splat_object.replace_gaussians(obj, splat_object.scene_from_object(obj).select(left))
    _add_further(obj, further, left)


def separate(obj: bpy.types.Object) -> bpy.types.Object:
    """Makes the selected Gaussians a splat of their own, with all of their attributes, and deletes them here.
    Returns it. Raises SceneError if none would be left."""
    mask = read(obj)
    _refuse_nothing(mask)
    _refuse_nothing(~mask)
    clear(obj)
    other = splat_object.copy_with(obj, obj.name, splat_object.scene_from_object(obj).select(mask))
    _add_further(other, splat_object.further_values(obj), mask)
    keep(obj, ~mask)
    return other


def _refuse_nothing(left: np.ndarray):
    if not left.any():
        raise SceneError(tr("no Gaussian would be left: keep more"))


def _add_further(obj: bpy.types.Object, further: list[tuple[str, str, np.ndarray]], rows: np.ndarray):
    """Gives a splat the attributes that it lacks. further: as further_values(). rows: those that it has."""
    for name, kind, values in further:
        if name not in obj.data.attributes:
            splat_object.set_values(obj, name, kind, values[rows])
