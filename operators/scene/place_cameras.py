"""Place Cameras: adds the cameras to the file from which a job without photographs takes its pictures, to
look at, move, add to or delete.

They are children of the splat. A child process finds the places (`svrgs rig`); Blender stays usable.
"""

from __future__ import annotations

import tempfile
from functools import partial
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import write_scene
from ...svrgs_addon.scene.camera import Camera
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ...svrgs_addon.views.camera_files import load_cameras
from ..data import background_work, edit_guard, known, splat_object, views_of_file, visible_splats
from ..data.extension import native_problem, threads
from ..data.reporting import ReportingOperator


def sentence(obj: bpy.types.Object) -> str:
    """What the panel says on it; mostly empty."""
    return tr("Placing cameras …") if known.of(obj).placing else known.of(obj).placing_problem


class SVRGS_OT_place_cameras(ReportingOperator):
    bl_label = "Place Cameras"
    bl_description = (
        "Add the cameras from which a fine-tuned job without photographs takes its pictures, to look at or to"
        " change. With Only This File's as Views, a job uses what you leave of them. They replace those that"
        " were placed for this splat before"
    )

    @classmethod
    def problem(cls, context) -> str:
        if problem := native_problem():
            return problem
        if not splat_object.is_splat(context.object):
            return tr("Select a Gaussian splat first")
        busy = tr("Placing cameras …") if known.of(context.object).placing else ""
        return edit_guard.problem(context, context.object) or busy

    def work(self, context) -> str:
        obj, uid = context.object, context.object.session_uid
        folder = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
        scene, out = (Path(folder.name) / name for name in ("scene.ply", "cameras.json"))
        write_scene(scene, visible_splats.visible_scene(obj))
        words = ["--seed", str(context.scene.svrgs_prune.seed), "--threads", str(threads(context)), "--json"]

        def work() -> list[Camera]:
            with folder:
                subprocess_python.ask(["rig", str(scene), "--out", str(out), *words])
                return load_cameras(out)

        known.of(obj).placing, known.of(obj).placing_problem = True, ""
        background_work.run(work, partial(_finished, uid))
        if not bpy.app.background:
            return tr("Placing cameras …")
        if known.of(obj).placing_problem:
            raise SplatError(known.of(obj).placing_problem)
        return tr("Placed {count:,} cameras").format(count=len(views_of_file.placed(obj)))


def _finished(uid: int, cameras: list[Camera], problem: str):
    """Adds the cameras to the file, in a collection of their own, unless their splat is gone."""
    known.of_uid(uid).placing, known.of_uid(uid).placing_problem = False, problem
    obj = next((obj for obj in bpy.data.objects if obj.session_uid == uid and obj.users_collection), None)
    if problem or obj is None:
        return
    name = tr("{name} Cameras").format(name=obj.name)
    collection = bpy.data.collections.get(name) or bpy.data.collections.new(name)
    if not collection.users:
        splat_object.collection_of(obj).children.link(collection)
    views_of_file.place(obj, cameras, collection)
    if not bpy.app.background:
        bpy.ops.ed.undo_push(message="Place Cameras")
