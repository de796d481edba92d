"""Apply Splat Transforms, Join Splats, and Write Shapes: the points, shapes and colours of splats change
together.

Blender's own Apply and Join move points only. A splat stores where its points were when its shapes were
written. So whoever reads it gets shapes and colours that have followed the points
(svrgs_addon/scene/attribute_layout.py); Write Shapes stores them.
"""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.app.translations import pgettext_n as n_

from ...svrgs_addon.scene.affine import UNIFORM, stretch, transformed
from ...svrgs_addon.scene.concatenate import concatenated
from ...svrgs_addon.system.errors import SceneError
from ..data import edit_guard, grading, known, selection, splat_object
from ..data.reporting import ReportingOperator
from ..data.select import select


def selected_splats(context) -> list[bpy.types.Object]:
    """The selected splats, the active one first; where none is selected, as after hiding, the active one."""
    splats = [obj for obj in context.selected_objects if splat_object.is_splat(obj)]
    if not splats and splat_object.is_splat(context.object):
        return [context.object]
    return sorted(splats, key=lambda obj: obj != context.object)


def stretch_warning(obj: bpy.types.Object) -> str:
    """What is not exact if the splat is written with another scale along each axis."""
    text = tr(
        "'{name}' is scaled differently along its axes: view-dependent colours are only rotated, and so not"
        " exact"
    )
    return text.format(name=obj.name)


class SplatsOperator(ReportingOperator):
    """An operator on the selected splats, of which there must be `least`."""

    least, too_few = 1, n_("Select a Gaussian splat first")

    @classmethod
    def problem(cls, context) -> str:
        splats = selected_splats(context)
        return edit_guard.change_problem(context, splats) if len(splats) >= cls.least else tr(cls.too_few)

    def warn_if_stretched(self, obj: bpy.types.Object, matrix):
        if stretch(matrix) - 1 > 10 * UNIFORM:
            self.report({"WARNING"}, stretch_warning(obj))


class SVRGS_OT_apply_transforms(SplatsOperator):
    bl_label = "Apply Splat Transforms"
    bl_description = (
        "Write location, rotation and scale of the selected splats into positions, shapes and view-dependent"
        " colours. Nothing seems to move"
    )

    def work(self, context) -> str:
        splats = selected_splats(context)
        if problem := edit_guard.shared(splats) or edit_guard.animated(splats):
            raise SceneError(problem)
        for obj in splats:
            stretch(obj.matrix_world)  # raises SceneError if a scale is zero
            self.warn_if_stretched(obj, obj.matrix_basis)
            splat_object.record_positions(obj)
        with context.temp_override(selected_editable_objects=splats, selected_objects=splats):
            bpy.ops.object.transform_apply()
        for obj in splats:
            splat_object.write_gaussians(obj, splat_object.scene_from_object(obj))
        return tr("Transforms applied. Splats: {count}").format(count=len(splats))


class SVRGS_OT_join_splats(SplatsOperator):
    bl_label = "Join Splats"
    bl_description = (
        "Join the selected splats into the active one. Positions, shapes and view-dependent colours keep"
        " their places in the scene"
    )
    least, too_few = 2, n_("Select two Gaussian splats or more")

    def work(self, context) -> str:
        splats = selected_splats(context)
        first, *others = splats
        if len({splat_object.scene_from_object(obj).antialiased for obj in splats}) > 1:
            text = tr(
                "some of these splats were trained with antialiasing and some were not: joined, one kind"
                " would be drawn wrongly"
            )
            raise SceneError(text)
        if len(set(map(grading.settings_of, splats))) > 1 or any(map(grading.is_animated, splats)):
            raise SceneError(tr("these splats have different colour settings: use Apply Color first"))
        scenes, hidden = [], [selection.hidden(obj) for obj in splats]
        further = [splat_object.further_values(obj) for obj in splats]
        for obj in splats:
            matrix = splat_object.relative(first.matrix_world, obj.matrix_world)
            self.warn_if_stretched(obj, matrix)
            scenes.append(transformed(splat_object.scene_from_object(obj), matrix))
        result = concatenated(scenes, columns=True)
        splat_object.replace_gaussians(first, result)
        selection.carry_hidden(first, hidden)
        if lost := selection.carry_further(first, further):
            text = tr("attributes that not all of these splats have are left out: {names}")
            self.report({"WARNING"}, text.format(names=", ".join(lost)))
        for obj in others:
            splat_object.delete(obj)
        select(context, [first])
        text = tr("Joined {splats} splats: {count:,} Gaussians")
        return text.format(splats=len(splats), count=result.count)


class SVRGS_OT_write_shapes(SplatsOperator):
    bl_label = "Write Shapes"
    bl_description = (
        "Blender's Apply or Join has moved the points of this splat and not its shapes. SVR-GS draws, prunes"
        " and exports the right shapes; this stores them, for Geometry Nodes and other add-ons"
    )

    def work(self, context) -> str:
        splats = selected_splats(context)
        count = sum(moved_count(obj) for obj in splats)
        for obj in splats:
            if splat_object.count_moved(obj):
                splat_object.write_gaussians(obj, splat_object.scene_from_object(obj))
        known.forget_points()
        return tr("Wrote the shapes of {count:,} Gaussians").format(count=count)


# --- what Blender has moved


def moved_count(obj: bpy.types.Object | None) -> int:
    """Number of Gaussians of the splat whose stored shapes do not belong to their points; 0 for other objects
    and in Edit Mode."""
    if not splat_object.is_splat(obj) or obj.mode == "EDIT":
        return 0
    points = known.of_data(obj)
    if points.moved is None:
        points.moved = splat_object.count_moved(obj)
    return points.moved


def _record_positions(scene, *_):
    """Stores the positions of splats that this extension has not made."""
    for obj in filter(splat_object.is_splat, scene.objects):
        if not obj.library and not obj.data.library and obj.mode != "EDIT":
            splat_object.record_positions(obj)


def _after_load(*_):
    for scene in bpy.data.scenes:
        _record_positions(scene)


def object_menu(self, context):
    if selected_splats(context):
        self.layout.separator()
        self.layout.operator(SVRGS_OT_apply_transforms.bl_idname)
        self.layout.operator(SVRGS_OT_join_splats.bl_idname)


HANDLERS = {"depsgraph_update_post": _record_positions, "load_post": _after_load}
MENUS = {"VIEW3D_MT_object": object_menu}
