"""Estimates how many Gaussians would stay, how good the result would be and how long pruning takes. A child
process does the work; Blender stays usable."""

from __future__ import annotations

import tempfile
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ..data import known, splat_object
from ..data.child_work import ChildWork, redraw_panels
from ..data.reporting import ReportingOperator
from ..data.splat_size import size_text
from .job import given_views, options_of, start_problem

MODULE = "svrgs_addon.jobs.estimate"
_child_work = ChildWork(done=redraw_panels)


def of(obj: bpy.types.Object | None) -> dict:
    """The last estimate of the active object: the result of jobs/estimate.py; {"busy": True}; or {"error":
    sentence, "status": exit status}.

    {} if there is none, or if the settings or the splat have changed since.
    """
    if obj is None or not splat_object.is_splat(obj):
        return {}
    found, made_of = known.of(obj).estimate, known.of(obj).estimated
    return found if "busy" in found or (found and made_of == _inputs_now(obj)) else {}


def _inputs_now(obj: bpy.types.Object) -> dict:
    """What an estimate depends on: the settings, and the identity and size of the splat's data. Where cameras
    of the file stand is left out."""
    return {
        **options_of(bpy.context, obj),
        "views": bpy.context.scene.svrgs_prune.views,
        "data": obj.data.session_uid,
        "splat": splat_object.count(obj),
    }


def sentences(obj: bpy.types.Object) -> list[str]:
    """The last estimate of the splat in words."""
    found = of(obj)
    if "error" in found:
        return [found["error"] or tr("the estimate ended with status {status}").format(**found)]
    kept, count = found["kept"], found["count"]
    stay = (
        tr("At most {kept:,} of {count:,} would stay ({share:.0%})")
        if found["at_most"]
        else tr("About {kept:,} of {count:,} would stay ({share:.0%})")
    )
    seen = tr("{invisible:,} invisible, {unseen:,} outside the {views} sampled views")
    if found["faint"]:
        seen = tr(
            "{invisible:,} invisible, {unseen:,} outside the {views} sampled views, {faint:,} dropped first"
            " as too faint"
        )
    time = (
        tr("About {minutes:.0f} min for {steps:,} steps")
        if found["seconds"] >= 120
        else tr("About {seconds:.0f} s for {steps:,} steps")
    )
    return [
        stay.format(kept=kept, count=count, share=kept / count),
        tr("{before} → about {after}").format(before=size_text(obj, count), after=size_text(obj, kept)),
        quality(found),
        seen.format(**found),
        time.format(minutes=found["seconds"] / 60, **found),
        *found["notes"],
    ]


def quality(found: dict) -> str:
    """The PSNRs of an estimate in words."""
    if found["psnr_before"] is None:
        text = tr(
            "PSNR about {psnr_after:.1f} dB or more against the splat's own pictures (without recovery about"
            " {psnr_removed:.1f} dB)"
        )
        return (
            text.format(**found)
            if found["psnr_after"] is not None
            else tr("The quality is not foreseen for this method or goal")
        )
    if found["psnr_after"] is None:
        return tr(
            "PSNR now {psnr_before:.1f} dB; after pruning: not foreseen for this method or goal"
        ).format(**found)
    return tr(
        "PSNR about {psnr_after:.1f} dB or more after pruning (now {psnr_before:.1f} dB; without recovery"
        " about {psnr_removed:.1f} dB)"
    ).format(**found)


class SVRGS_OT_estimate(ReportingOperator):
    bl_idname = "svrgs.estimate"
    bl_label = "Estimate"
    bl_description = (
        "Estimate within seconds how many Gaussians would stay, how good the result would be and how long"
        " pruning would take"
    )

    @classmethod
    def poll(cls, context):
        problem = (
            tr("An estimate is being made") if of(context.object).get("busy") else start_problem(context)
        )
        if problem:
            cls.poll_message_set(problem)
        return not problem

    def work(self, context) -> str:
        obj = context.object
        temp_dir = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
        options, cameras = options_of(context, obj), given_views(context, obj)
        write_scene(Path(temp_dir.name) / "scene.ply", splat_object.scene_from_object(obj))
        if cameras:
            # a Blender that only starts does not need it
            from ...svrgs_addon.views.cameras_json import write_cameras_json

            write_cameras_json(Path(temp_dir.name) / "cameras.json", cameras)
            options["cameras"] = str(Path(temp_dir.name) / "cameras.json")
        known.of(obj).estimate, known.of(obj).estimated = {"busy": True}, _inputs_now(obj)
        _child_work.start(
            _work,
            obj.session_uid,
            {"scene": str(Path(temp_dir.name) / "scene.ply"), "options": options},
            temp_dir,
        )
        if not bpy.app.background:
            return tr("Estimating from some views")
        found = of(obj)
        if "error" in found:
            raise SplatError(sentences(obj)[0])
        return "; ".join(sentences(obj))


def _work(key: int, request: dict, temp_dir: tempfile.TemporaryDirectory):
    with temp_dir:
        status, result = subprocess_python.run([], MODULE, request)
    known.of_uid(key).estimate = (
        result if "kept" in result else {"error": result.get("error", ""), "status": status}
    )


CLASSES = (SVRGS_OT_estimate,)


def unregister():
    _child_work.close()
