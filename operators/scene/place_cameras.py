"""Place Cameras: adds the cameras to the file from which a job without photographs takes its pictures, to
look at, move, add to or delete.

They are children of the splat. A child process finds the places (`svrgs rig`); Blender stays usable.
"""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.views.camera_files import load_cameras
from ..data import edit_guard, known, splat_object, views_of_file, visible_splats
from ..data.child_work import ChildWork, redraw_panels
from ..data.native_check import native_problem
from ..data.preferences import threads
from ..data.reporting import ReportingOperator


def sentence(obj: bpy.types.Object) -> str:
    """What the panel says on it; mostly empty."""
    return tr("Placing cameras …") if known.of(obj).placing else known.of(obj).problem


class SVRGS_OT_place_cameras(ReportingOperator):
    bl_idname = "svrgs.place_cameras"
    bl_label = "Place Cameras"
    bl_description = (
        "Add the cameras from which a fine-tuned job without photographs takes its pictures, to look at or to"
        " change. With Only This File's as Views, a job uses what you leave of them. They replace those that"
        " were placed for this splat before"
    )
    bl_options = {"REGISTER", "UNDO"}

    @classmethod
    def poll(cls, context):
        problem = native_problem() or (
            edit_guard.problem(context, context.object)
            if splat_object.is_splat(context.object)
            else tr("Select a Gaussian splat first")
        )
        if not problem and known.of(context.object).placing:
            problem = tr("Placing cameras …")
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj, folder = context.object, tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
        write_scene(Path(folder.name) / "scene.ply", visible_splats.visible_scene(obj))
        words = ["--seed", str(context.scene.svrgs_prune.seed), "--threads", str(threads(context)), "--json"]
        known.of(obj).placing, known.of(obj).problem = True, ""
        _child_work.start(_place, obj.session_uid, folder, words)
        if not bpy.app.background:
            return tr("Placing cameras …")
        if known.of(obj).problem:
            raise SplatError(known.of(obj).problem)
        return tr("Placed {count:,} cameras").format(count=len(views_of_file.placed(obj)))


def _place(uid: int, folder: tempfile.TemporaryDirectory, words: list[str]):
    """In a thread, which must not use bpy."""
    with folder:
        out = Path(folder.name) / "cameras.json"
        status, result = subprocess_python.run(
            ["rig", str(Path(folder.name) / "scene.ply"), "--out", str(out), *words]
        )
        try:
            known.of_uid(uid).placed = (
                {"error": result.get("error", ""), "status": status}
                if status
                else {"cameras": load_cameras(out)}
            )
        except SplatError as error:
            known.of_uid(uid).placed = {"error": str(error)}


def _finished():
    """Adds the cameras that have been found since."""
    for uid, splat in list(known.objects.items()):
        answer, splat.placed = splat.placed, None
        if answer is None:
            continue
        splat.placing = False
        obj = next((obj for obj in bpy.data.objects if obj.session_uid == uid and obj.users_collection), None)
        if "error" in answer:
            text = tr("placing cameras ended with status {status}")
            splat.problem = answer["error"] or text.format(**answer)
        elif obj is not None:
            _add(obj, answer["cameras"])
    redraw_panels()


def _add(splat: bpy.types.Object, cameras: list):
    """Adds the cameras to the file, in a collection of their own."""
    name = tr("{name} Cameras").format(name=splat.name)
    collection = bpy.data.collections.get(name) or bpy.data.collections.new(name)
    if not collection.users:
        splat.users_collection[0].children.link(collection)
    views_of_file.place(splat, cameras, collection)
    if not bpy.app.background:
        bpy.ops.ed.undo_push(message="Place Cameras")


_child_work = ChildWork(done=_finished)


CLASSES = (SVRGS_OT_place_cameras,)


def unregister():
    _child_work.close()
