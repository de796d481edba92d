"""Which cameras a splat is pruned with: whether they belong to it, and Use Cameras and Part From Cameras.

The check renders a few of the dataset's views, small, in a thread. It starts when the panel is drawn for a
splat with photographs.
"""

from __future__ import annotations

import os
import threading

import bpy
from bpy.app.handlers import persistent
from bpy.app.translations import pgettext_iface as tr
from bpy.props import StringProperty

from ...svrgs_addon.scene.gaussians import Scene
from ...svrgs_addon.system.errors import NativeError, SplatError
from ..data import edit_guard, splat_object
from ..data.child_work import redraw_panels
from .dataset_paths import dataset_of
from .splat_transforms import selected_splats

INTERVAL = 0.2  # seconds between two looks whether it is done

_found: dict[tuple, str] = {}  # by key: a sentence, empty if all is well
_wanted: list[tuple] = []  # keys that will be checked next, the newest last
_threads: list[threading.Thread] = []  # at most one


def sentence(context) -> str:
    """What is wrong between the active splat and its photographs; empty if nothing is, or if it is not known
    yet."""
    key = _key(context)
    if key is None:
        return ""
    if key not in _found and not bpy.app.background:
        _wanted[:] = [key]
        if not bpy.app.timers.is_registered(_work):
            bpy.app.timers.register(_work, first_interval=INTERVAL)
    return _found.get(key, "")


def check(context) -> str:
    """As sentence(), at once."""
    key = _key(context)
    if key is None:
        return ""
    _check(key, splat_object.scene_from_object(context.object))
    return _found[key]


def _key(context) -> tuple | None:
    """What the check depends on; None without a splat or a dataset that is there."""
    obj, (folder, images) = context.object, dataset_of(context)
    return (
        (obj.data.session_uid, splat_object.count(obj), folder, images)
        if splat_object.is_splat(obj) and os.path.exists(folder)
        else None
    )


def _work() -> float | None:
    """Starts the check that is wanted; reports what a thread has found."""
    if _threads and not _threads[0].is_alive():
        _threads.clear()
        redraw_panels()
    if _wanted and not _threads:
        key = _wanted.pop()
        obj = bpy.context.object
        if key not in _found and key == _key(bpy.context):
            _threads.append(
                threading.Thread(target=_check, args=(key, splat_object.scene_from_object(obj)), daemon=True)
            )
            _threads[0].start()
    return INTERVAL if _threads or _wanted else None


def _check(key: tuple, scene: Scene):
    """Runs in a thread: no bpy here."""
    from ...svrgs_addon.jobs.photo_sample import read_in_child  # not needed to start Blender
    from ...svrgs_addon.render.metrics.explained import fit, mismatch

    try:
        _found[key] = mismatch(fit(scene, read_in_child(*key[2:])))
    except (SplatError, NativeError, OSError):  # Estimate and Prune say what is wrong with the dataset
        _found[key] = ""


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


class SVRGS_OT_use_cameras(bpy.types.Operator):
    bl_idname = "svrgs.use_cameras"
    bl_label = "Use Cameras"
    bl_description = "Join the selected splats to these cameras, in the coordinates of their dataset"
    bl_options = {"REGISTER", "UNDO"}

    root: StringProperty(
        name="Cameras", description="Name of the empty above the cameras", options={"HIDDEN"}
    )

    @classmethod
    def poll(cls, context):
        problem = next(
            filter(None, (edit_guard.problem(context, obj) for obj in selected_splats(context))), ""
        )
        if not selected_splats(context):
            problem = tr("Select a Gaussian splat first")
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def execute(self, context):
        root = context.scene.objects.get(self.root)
        if root is None or splat_object.ROOT not in root:
            self.report(
                {"ERROR"},
                tr("'{name}' has no imported cameras: choose the empty above them").format(name=self.root),
            )
            return {"CANCELLED"}
        splats = selected_splats(context)
        for obj in splats:
            splat_object.move_below(obj, root)
        context.view_layer.update()
        problem = "" if bpy.app.background else sentence(context)
        done = tr("Joined to the cameras of '{name}'. Splats: {count}").format(
            name=root.name, count=len(splats)
        )
        self.report({"WARNING" if problem else "INFO"}, problem or done)
        return {"FINISHED"}


class SVRGS_OT_part_from_cameras(bpy.types.Operator):
    bl_idname = "svrgs.part_from_cameras"
    bl_label = "Part From Cameras"
    bl_description = (
        "Take the selected splats away from their cameras, for instance because those belong to another"
        " capture"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        if any(splat_object.root_of(obj) is not None for obj in selected_splats(context)):
            return True
        cls.poll_message_set(tr("Select a splat that was joined to cameras"))
        return False

    def execute(self, context):
        parted = [obj for obj in selected_splats(context) if splat_object.root_of(obj) is not None]
        for obj in parted:
            splat_object.move_below(obj, None)
        self.report({"INFO"}, tr("Parted from the cameras. Splats: {count}").format(count=len(parted)))
        return {"FINISHED"}


@persistent
def _after_load(*_):
    _found.clear()
    _wanted.clear()


CLASSES = (SVRGS_OT_use_cameras, SVRGS_OT_part_from_cameras)
HANDLERS = {"load_post": _after_load}
TIMERS = (_work,)


def unregister():
    for thread in _threads:
        thread.join()
    _threads.clear()
    _after_load()
