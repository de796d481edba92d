"""What an export writes of a splat, and in which coordinates: properties that the operators of export
share."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import BoolProperty, EnumProperty
from mathutils import Matrix

from ...svrgs_addon.files.repair import drop_nonfinite
from ...svrgs_addon.prune.seen import LARGEST
from ...svrgs_addon.scene.affine import UNIFORM, stretch, transformed
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.scene.concatenate import concatenated
from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import SceneError
from ...svrgs_addon.views.dataset import HOLDOUT
from ..data import camera_object, grading, splat_object, visible_splats
from ..data.world_matrix import world_matrix
from ..jobs import job_result
from ..scene.splat_transforms import stretch_warning
from ..translation import OWN


class ExportSpace:
    """Base class of the operators that export splats: the choice of the Gaussians and of the coordinates."""

    what: EnumProperty(
        name="Gaussians",
        description="Gaussians to write",
        items=[
            (
                "SEEN",
                "As Seen",
                (
                    "What the viewport shows of the splat: with its modifiers, instances and colour settings,"
                    " without Gaussians that are hidden"
                ),
            ),
            (
                "STORED",
                "All Stored",
                "All Gaussians of the splat as stored, also those that are hidden, without modifiers",
            ),
        ],
    )
    space: EnumProperty(
        name="Coordinates",
        translation_context=OWN,
        description="Coordinates of the file",
        items=[
            (
                "FILE",
                "Imported File",
                (
                    "Those of the imported file or of the dataset. What was moved, rotated or scaled since"
                    " then is moved in the file"
                ),
            ),
            ("LOCAL", "Local", "Those of the object. Its location, rotation and scale are left out"),
            ("WORLD", "World", "Those of Blender's world"),
        ],
    )
    y_down: BoolProperty(
        name="Y-Down File",
        default=True,
        description="World coordinates with y down, as in 3DGS files. Off: z up, as in Blender",
    )

    def draw_space(self, layout):
        layout.prop(self, "what")
        layout.prop(self, "space")
        row = layout.row()
        row.active = self.space == "WORLD"
        row.prop(self, "y_down")

    def chosen(self, context, obj: bpy.types.Object, parts: list | None = None) -> tuple[Scene, int]:
        """The Gaussians in the coordinates of the file, and how many with values that are not finite were
        left out. parts: (Scene, matrix to Blender's world) of each; None: those of gaussians(). Raises
        SplatError."""
        parts = parts or gaussians(context, obj, self.what == "SEEN")
        matrices = [self.to_space(obj, matrix) for _, matrix in parts]
        if any(stretch(matrix) - 1 > 10 * UNIFORM for matrix in matrices):
            self.report({"WARNING"}, stretch_warning(obj))  # type: ignore[attr-defined]  # of the operator
        placed = [transformed(scene, matrix) for (scene, _), matrix in zip(parts, matrices, strict=True)]
        found, dropped = drop_nonfinite(concatenated(placed, columns=True))
        if not found.count and splat_object.count(obj):
            raise SceneError(tr("no Gaussian of '{name}' is seen: nothing is written").format(name=obj.name))
        return found, dropped

    def to_space(self, obj: bpy.types.Object, matrix):
        """(4, 4) from the object's coordinates to those of the file. matrix: from them to Blender's world."""
        if self.space == "FILE":
            return splat_object.to_file(obj, matrix)
        world = splat_object.AXES if self.y_down else Matrix()
        return splat_object.relative(world if self.space == "WORLD" else world_matrix(obj), matrix)

    def in_space(self, obj: bpy.types.Object, cameras: list[Camera]) -> list[Camera]:
        """Views in Blender's world, in the coordinates of the file."""
        to_world = Matrix(self.to_space(obj, Matrix())).inverted()
        return [camera.moved(to_world) for camera in cameras]

    def left_out(self, obj: bpy.types.Object, dropped: int) -> list[str]:
        """What the file does not hold, in words."""
        hidden = visible_splats.marked_count(obj) if self.what == "SEEN" else 0
        texts = {
            tr("without {count:,} that are hidden"): hidden,
            tr("without {count:,} with values that are not finite"): dropped,
        }
        return [text.format(count=count) for text, count in texts.items() if count]


def shows_original(obj: bpy.types.Object) -> bool:
    """Whether the slider Keep of a result shows more Gaussians than its job has kept: its original shows
    them."""
    return job_result.undecided(obj) and job_result.ranked(obj) and job_result.Shown(obj).brings_back


def camera_objects(context, obj: bpy.types.Object) -> list[bpy.types.Object]:
    """The imported cameras of a splat; all that are imported, if it is joined to none."""
    root = splat_object.root_of(obj)
    pool = context.scene.objects if root is None else root.children_recursive
    return [one for one in camera_object.photographs(pool) if one.data.type == "PERSP"]


def imported_cameras(context, obj: bpy.types.Object) -> tuple[list[Camera], list[Camera]]:
    """The views of camera_objects() in Blender's world, reduced: those that say from where Gaussians are
    seen, and those held out, in which it can be measured what a file loses."""
    found = (camera_object.camera_from_object(one, context.scene) for one in camera_objects(context, obj))
    views = sorted((view.fitted(LARGEST) for view in found), key=lambda view: view.name)
    return [view for i, view in enumerate(views) if i % HOLDOUT], views[::HOLDOUT]


def gaussians(context, obj: bpy.types.Object, seen: bool) -> list:
    """[(Scene, matrix to Blender's world)] of a splat: what the viewport shows of it, or all that is stored.
    Raises SceneError."""
    if not seen:
        return [(splat_object.scene_from_object(obj), world_matrix(obj))]
    if obj.mode == "EDIT" and (visible_splats.has_marks(obj) or job_result.undecided(obj)):
        raise SceneError(tr("Leave Edit Mode first"))
    if shows_original(obj):
        return [(grading.applied(job_result.Shown(obj).seen_gaussians, obj), world_matrix(obj))]
    if problem := grading.problem(obj):
        raise SceneError(problem)
    parts = visible_splats.shown_by(context.evaluated_depsgraph_get(), obj) if obj.mode != "EDIT" else []
    if parts:
        return parts
    modifiers = (modifier.name for modifier in obj.modifiers if modifier.show_viewport)
    if any(name != visible_splats.HIDE_MODIFIER for name in modifiers):
        text = tr(
            "Blender does not apply the modifiers of '{name}' in Edit Mode or while it is hidden: show it, or"
            " export All Stored"
        )
        raise SceneError(text.format(name=obj.name))
    if obj.mode != "EDIT":
        return [(visible_splats.visible_scene(obj), world_matrix(obj))]
    return [(grading.applied(splat_object.scene_from_object(obj), obj), world_matrix(obj))]
