"""Says what pruning would do and cost, before anything runs. A process looks; Blender goes on meanwhile."""

from __future__ import annotations

import tempfile
import threading
from pathlib import Path

import bpy

from ..svrgs_addon.blender import subprocess_python
from ..svrgs_addon.errors import SplatError
from ..svrgs_addon.files.registry import write_scene
from . import bridge
from .job import JobOperator, file_size, obstacle, options_of
from .job_watch import redraw_panels

MODULE = "svrgs_addon.jobs.estimate"
EVERY = 0.1  # seconds

_found: dict[int, dict] = {}  # by session_uid of the splat: what was found out, {"busy": True} until then
_asked: dict[int, dict] = {}  # by session_uid of the splat: what the last estimate was made for
_threads: list[threading.Thread] = []


def of(obj: bpy.types.Object | None) -> dict:
    """What the last estimate of the splat found; {"busy": True}; {"error": sentence}; {} where there was none, or it was of something else.

    obj: the active object, if it is a splat.
    """
    found = _found.get(obj.session_uid, {}) if bridge.is_splat(obj) else {}
    return found if "busy" in found or (found and _asked[obj.session_uid] == _question(obj)) else {}


def _question(obj: bpy.types.Object) -> dict:
    """What an estimate depends on: the settings, and the splat as far as a look tells."""
    return {**options_of(bpy.context, obj), "data": obj.data.session_uid, "splat": bridge.count(obj)}


def sentences(obj: bpy.types.Object) -> list[str]:
    """The last estimate of the splat in words."""
    found = of(obj)
    if "error" in found:
        return [found["error"]]
    kept, count = found["kept"], found["count"]
    minutes, speed = found["seconds"] / 60, f"({found['steps_per_second']:.0f} steps/s)"
    return [
        f"{'At most' if found['at_most'] else 'About'} {kept:,} of {count:,} would stay ({kept / count:.0%})",
        f"{file_size(obj, count)} → about {file_size(obj, kept)}",
        f"{found['invisible']:,} too faint to be seen, {found['unseen']:,} in none of {found['views']} views, {found['faint']:,} next to nothing",
        f"About {minutes:.0f} min {speed}" if minutes >= 1 else f"Less than a minute {speed}",
    ]


class SVRGS_OT_estimate(JobOperator):
    bl_idname = "svrgs.estimate"
    bl_label = "Estimate"
    bl_description = "Say within seconds how many Gaussians would stay, and how long pruning would take"

    @classmethod
    def poll(cls, context):
        problem = "An estimate is being made" if of(context.object).get("busy") else obstacle(context)
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj = context.object
        temp_dir = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
        write_scene(Path(temp_dir.name) / "scene.ply", bridge.scene_from_object(obj))
        _found[obj.session_uid], _asked[obj.session_uid] = {"busy": True}, _question(obj)
        thread = threading.Thread(
            target=_work, args=(obj.session_uid, {"scene": str(Path(temp_dir.name) / "scene.ply"), "options": options_of(context, obj)}, temp_dir)
        )
        _threads.append(thread)
        thread.start()
        if not bpy.app.background:
            bpy.app.timers.register(_finished, first_interval=EVERY)
            return "Looking at some views"
        thread.join()
        _finished()
        found = of(obj)
        if "error" in found:
            raise SplatError(found["error"])
        return "; ".join(sentences(obj))


def _work(key: int, request: dict, temp_dir: tempfile.TemporaryDirectory):
    with temp_dir:
        status, result = subprocess_python.run([], MODULE, request)
    _found[key] = result if "kept" in result else {"error": result.get("error", f"the estimate ended with status {status}")}


def _finished() -> float | None:
    if any(thread.is_alive() for thread in _threads):
        return EVERY
    _threads.clear()
    redraw_panels()
    return None


def register():
    bpy.utils.register_class(SVRGS_OT_estimate)


def unregister():
    bpy.utils.unregister_class(SVRGS_OT_estimate)
    if bpy.app.timers.is_registered(_finished):
        bpy.app.timers.unregister(_finished)
    for thread in _threads:
        thread.join()
    _threads.clear()
    _found.clear()
    _asked.clear()
