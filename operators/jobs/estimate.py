"""Estimates how many Gaussians would stay, how good the result would be and how long pruning takes. A child
process does the work; Blender stays usable."""

from __future__ import annotations

import tempfile
from concurrent.futures import Future
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ..data import background_work, known, splat_object
from ..data.reporting import ReportingOperator
from ..data.splat_size import size_text
from .job import given_views, options_of, start_problem

MODULE = "svrgs_addon.jobs.estimate"


def of(obj: bpy.types.Object | None) -> dict:
    """The last estimate of the active object: the result of jobs/estimate.py; {"busy": True}; or {"error":
    sentence}.

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
        return [found["error"]]
    kept, count = found["kept"], found["count"]
    stay = (
        tr("At most {kept:,} of {count:,} would stay ({share:.0%})")
        if found["at_most"]
        else tr("About {kept:,} of {count:,} would stay ({share:.0%})")
    )
    seen = tr("{invisible:,} Gaussians are invisible; {unseen:,} are in none of the {views} views looked at")
    if found["faint"]:
        seen = tr(
            "{invisible:,} Gaussians are invisible; {unseen:,} are in none of the {views} views looked at;"
            " {faint:,} are too faint and go first"
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
        tr("A pixel blends {overdraw_before:.0f} Gaussians, then about {overdraw_after:.0f}").format(**found),
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
        if found["psnr_after"] is not None:
            return text.format(**found)
        return tr("The quality is not foreseen for this method or goal")
    figures = (found["psnr_before"], found["psnr_after"], found["psnr_removed"])
    if None not in figures and len({round(value, 1) for value in figures}) == 1:
        return tr("PSNR stays at about {psnr_before:.1f} dB").format(**found)
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
    def problem(cls, context) -> str:
        if of(context.object).get("busy"):
            return tr("An estimate is being made")
        return start_problem(context)

    def work(self, context) -> str:
        obj, uid = context.object, context.object.session_uid
        temp_dir = tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
        scene, options = Path(temp_dir.name) / "scene.ply", options_of(context, obj)
        cameras = given_views(context, obj)
        write_scene(scene, splat_object.scene_from_object(obj))
        if cameras:
            # a Blender that only starts does not need it
            from ...svrgs_addon.views.cameras_json import write_cameras_json

            write_cameras_json(scene.with_name("cameras.json"), cameras)
            options["cameras"] = str(scene.with_name("cameras.json"))

        def work() -> dict:
            with temp_dir:
                return subprocess_python.ask([], MODULE, {"scene": str(scene), "options": options})

        def done(answer: Future):
            try:
                known.of_uid(uid).estimate = answer.result()
            except (SplatError, OSError) as error:
                known.of_uid(uid).estimate = {"error": str(error)}

        known.of(obj).estimate, known.of(obj).estimated = {"busy": True}, _inputs_now(obj)
        background_work.run(work, done)
        if not bpy.app.background:
            return tr("Estimating from some views")
        if "error" in of(obj):
            raise SplatError(of(obj)["error"])
        return "; ".join(sentences(obj))


CLASSES = (SVRGS_OT_estimate,)
