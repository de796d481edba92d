"""Blender's dependency graph -> the Gaussians of all splats, and cameras.

One splat alone is drawn in its own coordinates, by a camera that is moved there. Several splats, or one that
is stretched or mirrored, are transformed into the axes of the world.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property

import bpy
import numpy as np
from bpy.app.translations import pgettext_iface as tr
from mathutils import Matrix

from ...svrgs_addon.render.meshes import Surface, Triangles, surface
from ...svrgs_addon.render.thinning import Thinning
from ...svrgs_addon.scene.affine import UNIFORM, stretch, transformed
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.concatenate import concatenated
from ...svrgs_addon.scene.gaussians import Scene, parameter_shapes
from ...svrgs_addon.scene.grade import inside
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.views.lens import camera_of_projection
from ...svrgs_addon.views.rig.space import unit_around
from . import camera_object, grading, quick_order, splat_object, view_layers

REMOVED = "removed"  # attribute: marks Gaussians that pruning would remove; they are not drawn
HIDDEN = "svrgs:hidden"  # attribute: marks Gaussians that the user has hidden; they are not drawn
HIDE_MODIFIER = "SVR-GS Removed"  # the modifier that hides marked Gaussians, and its node group

Read = Callable[[bpy.types.Object], Scene]


@dataclass(frozen=True)
class PlacedScene:
    """The Gaussians of one picture, and where they are in Blender's world."""

    scene: Scene
    matrix: Matrix  # from the scene's coordinates to Blender's world: no shear, no mirroring
    mixed: bool = False  # some splats were trained with antialiasing, and are drawn without it, as the others

    @cached_property
    def thinning(self) -> Thinning:
        """What coarse pictures draw. For the thread that draws."""
        return Thinning(self.scene)

    @property
    def _camera_unit(self) -> float:
        """Camera.unit of what sees the scene. It is kept with the scene: finding it takes 0.05 s, and a
        viewport makes a new PlacedScene for each picture while the splat is moved."""
        kept = vars(self.scene)
        if "camera_unit" not in kept:
            kept["camera_unit"] = unit_around(self.scene)
        return kept["camera_unit"]

    @property
    def unit(self) -> float:
        """Length of one unit of the scene in Blender's world."""
        return abs(self.matrix.to_3x3().determinant()) ** (1 / 3)

    def seen_by(self, camera: Camera) -> Camera:
        """The camera, given in Blender's world, in the scene's coordinates."""
        return replace(camera.moved(self.matrix), unit=self._camera_unit)

    def hidden_by(self, triangles: Triangles, camera: Camera) -> Surface | None:
        """The triangles as the camera (in Blender's world) sees them; depths in units of the scene. None if
        there are none."""
        found = surface(triangles, camera)
        return found and found.scaled(1 / self.unit)


def visible_scene(obj: bpy.types.Object) -> Scene:
    """The Gaussians of visible_rows() with the splat's grade; of a quick result, those that
    the slider Keep shows."""
    if (shown := quick_order.shown(obj.original)) is None:
        shown, rows = splat_object.scene_from_object(obj), visible_rows(obj)
        shown = shown if len(rows) == shown.count else shown.select(rows)  # a copy takes as long as reading
    return grading.applied(shown, obj)


def visible_rows(obj: bpy.types.Object) -> np.ndarray:
    """Rows of the Gaussians that are neither marked as removed, nor hidden, nor outside the splat's crop
    box."""
    rows, grade = unmarked_rows(obj), grading.of(obj)
    if grade.crop is None:
        return rows
    return rows[inside(splat_object.stored_values(obj, splat_object.POSITION)[rows], grade) > 0]


def unmarked_rows(obj: bpy.types.Object) -> np.ndarray:
    """Rows of the Gaussians that are neither marked as removed nor hidden."""
    return np.flatnonzero(~marked(obj))


def marked(obj: bpy.types.Object) -> np.ndarray:
    """(N,) bool: the Gaussians that are marked as removed, or hidden."""
    mask = np.zeros(splat_object.count(obj), bool)
    for name in _marks(obj):
        if (values := splat_object.values(obj, name)) is not None:
            mask |= values.astype(bool)
    return mask


def marked_count(obj: bpy.types.Object) -> int:
    """Number of the Gaussians that are marked as removed, or hidden."""
    return int(marked(obj).sum()) if has_marks(obj) else 0


def has_marks(obj: bpy.types.Object) -> bool:
    """Whether attributes of the splat mark Gaussians as removed, or hidden."""
    return bool(_marks(obj))


def _marks(obj: bpy.types.Object) -> list[str]:
    """The attributes that hide Gaussians."""
    names = (HIDDEN,) if _is_twin(obj.original) else (REMOVED, HIDDEN)
    return [name for name in names if name in obj.data.attributes]


def _is_twin(obj: bpy.types.Object) -> bool:
    """Whether the splat is a linked duplicate of one of a job: it has the attributes of that splat, but not
    its modifier, and is a splat of its own."""
    if obj.data.users < 2 or HIDE_MODIFIER in obj.modifiers:
        return False
    return any(other.data == obj.data and HIDE_MODIFIER in other.modifiers for other in bpy.data.objects)


def splats(depsgraph: bpy.types.Depsgraph, read: Read = visible_scene) -> PlacedScene | None:
    """All splats that the graph shows, with modifiers applied; None if there is none.

    read: from an evaluated object to its Gaussians. Raises SceneError.
    """
    found = [(read(obj), matrix) for obj, matrix in placed_splats(depsgraph)]
    return placed(found) if found else None


def placed_splats(depsgraph: bpy.types.Depsgraph) -> Iterator[tuple[bpy.types.Object, Matrix]]:
    """Every evaluated splat that the graph shows, with its matrix. Blender frees these objects soon: use them
    at once."""
    splats = (i for i in _instances(depsgraph) if splat_object.is_splat(i.object))
    found = (i for i in splats if not view_layers.is_indirect(i, depsgraph))
    return ((i.object, i.matrix_world.copy()) for i in found)


def holdouts(depsgraph: bpy.types.Depsgraph) -> set[str]:
    """The names of the splats that are set as holdouts, by themselves or by the view layer."""
    found = (i for i in _instances(depsgraph) if splat_object.is_splat(i.object))
    return {
        i.object.name for i in found if i.object.is_holdout or view_layers.marks(i, depsgraph, "holdout_get")
    }


def shown_by(depsgraph: bpy.types.Depsgraph, obj: bpy.types.Object) -> list[tuple[Scene, Matrix]]:
    """What the graph shows of a splat: it and its instances, with modifiers and without removed Gaussians,
    and their matrices to the world."""
    mine = (i for i in _instances(depsgraph) if _is_of(i, obj))
    return [(visible_scene(i.object), i.matrix_world.copy()) for i in mine if splat_object.is_splat(i.object)]


def made_by_nodes(context, obj: bpy.types.Object | None) -> bool:
    """Whether the object is no splat, and its geometry nodes make one."""
    if obj is None or splat_object.is_splat(obj) or not _may_instance(obj):
        return False
    graph = context.view_layer.depsgraph
    instances = graph.object_instances if graph else ()
    return any(splat_object.is_splat(i.object) and _is_of(i, obj) for i in instances)


def _is_of(instance: bpy.types.DepsgraphObjectInstance, obj: bpy.types.Object) -> bool:
    """Whether it is the object itself, or the object has made it."""
    parent = instance.parent if instance.is_instance else None
    return obj in (instance.object.original, parent and parent.original)


def splats_in_view(context: bpy.types.Context) -> Iterator[tuple[bpy.types.Object, Matrix]]:
    """Every evaluated splat that a viewport shows, with its matrix; also instances. Blender frees these
    objects soon: use them at once."""
    graph, space = context.view_layer.depsgraph, context.space_data
    for obj in context.view_layer.objects:
        if splat_object.is_splat(obj) and obj.visible_get(viewport=space):
            evaluated = obj.evaluated_get(graph)
            if splat_object.is_splat(evaluated):  # nodes may have made instances of it, and left nothing else
                yield evaluated, obj.matrix_world.copy()
    if any(_may_instance(obj) for obj in bpy.data.objects):  # the loop over all instances is slow
        for i in graph.object_instances:
            if (
                i.is_instance
                and i.show_self
                and splat_object.is_splat(i.object)
                and i.parent.original.visible_get(viewport=space)
            ):
                yield i.object, i.matrix_world.copy()


def _may_instance(obj: bpy.types.Object) -> bool:
    """Whether the object can show other objects or geometry in several places."""
    if obj.instance_type != "NONE" or any(
        system.settings.render_type in ("OBJECT", "COLLECTION") for system in obj.particle_systems
    ):
        return True
    return any(modifier.type == "NODES" and modifier.name != HIDE_MODIFIER for modifier in obj.modifiers)


def nothing() -> PlacedScene:
    """No Gaussian at all."""
    arrays = (np.empty(shape) for shape in parameter_shapes(0, 1).values())
    return PlacedScene(Scene.of(*arrays), Matrix())


def placed(scenes: list[tuple[Scene, Matrix]]) -> PlacedScene:
    """One picture of scenes with their matrices to Blender's world; see the top of this file. Several are
    placed around the first one, as float32 is coarse far from the origin. Those that are scaled to nothing
    show nothing. Raises SceneError."""
    scene, matrix = scenes[0]
    if len(scenes) == 1 and matrix.determinant() > 0 and stretch(matrix) - 1 <= UNIFORM:
        return PlacedScene(scene, matrix)
    origin = Matrix.Translation(matrix.translation)
    back = np.array(origin.inverted(), np.float64)
    with_volume = [one for one in scenes if any(one[1].to_scale())] or scenes
    in_world = [transformed(scene, back @ np.array(matrix, np.float64)) for scene, matrix in with_volume]
    mixed = len({scene.antialiased for scene in in_world}) > 1
    return PlacedScene(concatenated(in_world), origin, mixed)


def camera(depsgraph: bpy.types.Depsgraph, override: bpy.types.Object | None = None) -> bpy.types.Object:
    """The evaluated camera of the render. Raises SceneError."""
    obj = override or depsgraph.scene.camera
    if obj is None:
        raise SceneError(
            tr("the scene has no camera: add one, or make one the scene's camera (Ctrl Numpad 0)")
        )
    return obj.evaluated_get(depsgraph)


def region_camera(region: bpy.types.Region, view: bpy.types.RegionView3D) -> Camera:
    """The view of a 3D viewport, in Blender's world."""
    viewmat = camera_object.FLIP @ np.array(view.view_matrix, np.float64)
    return camera_of_projection(view.window_matrix, viewmat, region.width, region.height)


def _instances(depsgraph: bpy.types.Depsgraph) -> Iterator:
    return (instance for instance in depsgraph.object_instances if instance.show_self)
