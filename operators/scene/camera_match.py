"""Which cameras a splat is pruned with: whether they belong to it, and Use Cameras and Part From Cameras.

The check renders a few of the dataset's views, small, in a thread. It starts when the panel is drawn for a
splat with photographs.
"""

from __future__ import annotations

import os
from functools import partial

import bpy
from bpy.app.translations import pgettext_iface as tr
from bpy.props import StringProperty

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import NativeError, SplatError
from ..data import background_work, edit_guard, known, splat_object
from ..data.reporting import ReportingOperator
from .dataset_paths import dataset_of
from .splat_transforms import selected_splats


def sentence(context) -> str:
    """What is wrong between the active splat and its photographs; empty if nothing is, or if it is not known
    yet."""
    key = _key(context)
    if key is None:
        return ""
    checked_for, problem = known.of(context.object).cameras_checked
    if checked_for == key:
        return problem
    background_work.watch(check)  # a panel that is drawn must not wait for a splat to be read
    return ""


def _key(context) -> tuple | None:
    """What the check depends on; None without a splat or a dataset that is there."""
    obj, (folder, images) = context.object, dataset_of(context)
    if splat_object.is_splat(obj) and os.path.exists(folder):
        points = splat_object.some_positions(obj), splat_object.count(obj)
        return (obj.data.session_uid, points, folder, images)
    return None


def check() -> bool:
    """Starts the check of the active splat, unless that was made. Returns False: it is called once."""
    obj, key = bpy.context.object, _key(bpy.context)
    if key is not None and known.of(obj).cameras_checked[0] != key:
        known.of(obj).cameras_checked = key, ""
        scene, uid = splat_object.scene_from_object(obj), obj.session_uid

        def done(problem: str | None, _):
            known.of_uid(uid).cameras_checked = key, problem or ""

        background_work.run(partial(_mismatch, scene, *key[2:]), done, detached=True)
    return False


def _mismatch(scene: Scene, folder: str, images: str) -> str:
    """Runs in a thread: no bpy here."""
    from ...svrgs_addon.jobs.photo_sample import read_in_child  # not needed to start Blender
    from ...svrgs_addon.render.metrics.explained import fit, mismatch

    try:
        return mismatch(fit(scene, read_in_child(folder, images)))
    except (SplatError, NativeError, OSError):  # Estimate and Prune say what is wrong with the dataset
        return ""


def cameras_of(obj: bpy.types.Object | None) -> str:
    """The cameras that the splat is joined to, in words; empty if there are none."""
    root = splat_object.root_of(obj) if splat_object.is_splat(obj) else None
    if root is None or not _camera_count(root):
        return ""
    return tr("{count:,} cameras of '{name}'").format(count=_camera_count(root), name=root.name)


def roots(scene: bpy.types.Scene) -> list[str]:
    """Names of the empties of a scene that are above imported cameras."""
    return [obj.name for obj in scene.objects if splat_object.ROOT in obj and _camera_count(obj)]


def _camera_count(root: bpy.types.Object) -> int:
    return sum(child.type == "CAMERA" for child in root.children)


def place_problem(context, splats: list[bpy.types.Object]) -> str:
    """Why these splats cannot be joined to other cameras now; empty if they can."""
    problem = next(filter(None, (edit_guard.problem(context, obj) for obj in splats)), "")
    return problem or edit_guard.animated(splats)


class SVRGS_OT_use_cameras(ReportingOperator):
    bl_label = "Use Cameras"
    bl_description = "Join the selected splats to these cameras, in the coordinates of their dataset"

    root: StringProperty(
        name="Cameras", description="Name of the empty above the cameras", options={"HIDDEN"}
    )

    @classmethod
    def problem(cls, context) -> str:
        splats = selected_splats(context)
        if not splats:
            return tr("Select a Gaussian splat first")
        return place_problem(context, splats)

    def work(self, context) -> str:
        root = context.scene.objects.get(self.root)
        if root is None or splat_object.ROOT not in root:
            text = tr("'{name}' has no imported cameras: choose the empty above them")
            raise SplatError(text.format(name=self.root))
        splats = selected_splats(context)
        for obj in splats:
            splat_object.move_below(obj, root)
        context.view_layer.update()
        if problem := sentence(context):
            self.report({"WARNING"}, problem)
            return ""
        text = tr("Joined to the cameras of '{name}'. Splats: {count}")
        return text.format(name=root.name, count=len(splats))


class SVRGS_OT_part_from_cameras(ReportingOperator):
    bl_label = "Part From Cameras"
    bl_description = (
        "Take the selected splats away from their cameras, for instance because those belong to another"
        " capture"
    )

    @classmethod
    def problem(cls, context) -> str:
        splats = [obj for obj in selected_splats(context) if splat_object.root_of(obj) is not None]
        if not splats:
            return tr("Select a splat that was joined to cameras")
        return place_problem(context, splats)

    def work(self, context) -> str:
        parted = [obj for obj in selected_splats(context) if splat_object.root_of(obj) is not None]
        for obj in parted:
            splat_object.move_below(obj, None)
        return tr("Parted from the cameras. Splats: {count}").format(count=len(parted))
