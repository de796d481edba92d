"""Estimates how many Gaussians would stay, how good the result would be and how long pruning takes. A child
process does the work; Blender stays usable.

The panel Prune keeps the estimate up to date: when it is drawn with other settings, a new one begins WAIT
seconds after the last change.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.files.registry import write_scene
from ...svrgs_addon.system import subprocess_python
from ...svrgs_addon.system.errors import SplatError
from ..data import background_work, known, splat_object
from ..data.file_kinds import default_kind, format_of
from ..data.reporting import ReportingOperator
from ..data.splat_size import file_size_text
from .job import given_views, options_of, start_problem

MODULE = "svrgs_addon.jobs.estimate"
WAIT = 0.8  # seconds without a change of the settings
MOST = 500_000  # Gaussians of a splat whose estimate is made unasked

_wanted: list = []  # the inputs of the estimate that begins soon, and time.monotonic() of their last change


def of(obj: bpy.types.Object | None) -> dict:
    """The last estimate of the active object: the result of jobs/estimate.py; {"busy": True}; or {"error":
    sentence}.

    {} if there is none, or if the settings or the splat have changed since.
    """
    if not splat_object.is_splat(obj):
        return {}
    made_of, found = known.of(obj).estimate
    return found if "busy" in found or (found and made_of == _inputs_now(obj)) else {}


def _inputs_now(obj: bpy.types.Object) -> dict:
    """What an estimate depends on: the settings, and the identity and size of the splat's data. Where cameras
    of the file stand is left out."""
    views, data = bpy.context.scene.svrgs_prune.views, obj.data.session_uid
    return options_of(bpy.context, obj) | {"views": views, "data": data, "splat": splat_object.count(obj)}


def line(obj: bpy.types.Object) -> str:
    """The last estimate of the splat in a short line: Gaussians, with the goal Device those that a
    pixel blends, size, PSNR, time. Empty if there is none."""
    found = of(obj)
    if not found:
        return ""
    if "busy" in found:
        return tr("Estimating …")
    if "error" in found:
        return tr("No estimate")
    count, after, seconds = found["kept"], found["psnr_after"], found["seconds"]
    lasts = tr("{minutes:.0f} min").format(minutes=seconds / 60) if seconds >= 120 else f"{seconds:.0f} s"
    size = f"{file_size_text(found['bytes_after'])} {found['format']}"
    quality = [f"≥ {after:.1f} dB"] if after is not None else []
    for_device = bpy.context.scene.svrgs_prune.goal == "DEVICE"
    overdraw = [tr("{overdraw_after:.0f} a pixel").format(**found)] if for_device else []
    return " · ".join((f"≈ {count:,}", *overdraw, size, *quality, lasts))


def sentences(obj: bpy.types.Object) -> list[str]:
    """The last estimate of the splat in words; [] if there is none."""
    found = of(obj)
    if "error" in found:
        return [found["error"]]
    if "kept" not in found:
        return []
    kept, count = found["kept"], found["count"]
    stay = tr("About {kept:,} of {count:,} would stay ({share:.0%})")
    if found["at_most"]:
        stay = tr("At most {kept:,} of {count:,} would stay ({share:.0%})")
    seen = tr("{invisible:,} Gaussians are invisible; {unseen:,} are in none of the {views} views looked at")
    if found["faint"]:
        seen = tr(
            "{invisible:,} Gaussians are invisible; {unseen:,} are in none of the {views} views looked at;"
            " {faint:,} are too faint and go first"
        )
    lasts = tr("About {seconds:.0f} s for {steps:,} steps")
    if found["seconds"] >= 120:
        lasts = tr("About {minutes:.0f} min for {steps:,} steps")
    before, after = file_size_text(found["bytes_before"]), file_size_text(found["bytes_after"])
    return [
        stay.format(kept=kept, count=count, share=kept / count),
        tr("{before} → about {after} as {format}").format(before=before, after=after, format=found["format"]),
        quality(found),
        tr("A pixel blends {overdraw_before:.0f} Gaussians, then about {overdraw_after:.0f}").format(**found),
        seen.format(**found),
        lasts.format(minutes=found["seconds"] / 60, **found),
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
        text = tr("PSNR now {psnr_before:.1f} dB; after pruning: not foreseen for this method or goal")
        return text.format(**found)
    return tr(
        "PSNR about {psnr_after:.1f} dB or more after pruning (now {psnr_before:.1f} dB; without recovery"
        " about {psnr_removed:.1f} dB)"
    ).format(**found)


class SVRGS_OT_estimate(ReportingOperator):
    bl_label = "Estimate"
    bl_description = (
        "Estimate within seconds how many Gaussians would stay, how good the result would be and how long"
        " pruning would take"
    )
    bl_options = set()

    @classmethod
    def problem(cls, context) -> str:
        if of(context.object).get("busy"):
            return tr("An estimate is being made")
        return start_problem(context)

    def work(self, context) -> str:
        obj = context.object
        begin(context, obj)
        if not bpy.app.background:
            return tr("Estimating from some views")
        if "error" in of(obj):
            raise SplatError(of(obj)["error"])
        return "; ".join(sentences(obj))


def begin(context, obj: bpy.types.Object):
    """Starts an estimate for a splat. In background mode it waits for it."""
    uid, temp_dir = obj.session_uid, tempfile.TemporaryDirectory(dir=bpy.app.tempdir)
    path, options = Path(temp_dir.name) / "scene.ply", options_of(context, obj)
    suffix = options.get("target_format", format_of(default_kind(obj)).suffixes[0])
    cameras, scene = given_views(context, obj), splat_object.scene_from_object(obj)
    if cameras:
        # a Blender that only starts does not need it
        from ...svrgs_addon.views.cameras_json import write_cameras_json

        write_cameras_json(path.with_name("cameras.json"), cameras)
        options["cameras"] = str(path.with_name("cameras.json"))

    def work() -> dict:
        with temp_dir:
            write_scene(path, scene)
            request = {"scene": str(path), "options": options, "suffix": suffix}
            return subprocess_python.ask([], MODULE, request)

    def done(found: dict, error: str):
        known.of_uid(uid).estimate = inputs, {"error": error} if error else found

    inputs = _inputs_now(obj)
    known.of(obj).estimate = inputs, {"busy": True}
    background_work.run(work, done)


def is_live(obj: bpy.types.Object) -> bool:
    """Whether the estimate of a splat is made unasked."""
    return splat_object.count(obj) <= MOST


def keep_up(context):
    """Lets an estimate begin soon if that of the active splat is missing. May be called while a panel is
    drawn."""
    if is_live(context.object) and not of(context.object):
        background_work.watch(_begin_soon)


def _begin_soon() -> bool:
    """Begins the estimate once the settings have not changed for a while. Returns whether that is waited
    for."""
    context, obj = bpy.context, bpy.context.object
    if not splat_object.is_splat(obj) or of(obj) or start_problem(context):
        _wanted.clear()
        return False
    inputs = _inputs_now(obj)
    if not _wanted or _wanted[0] != inputs:
        _wanted[:] = inputs, time.monotonic()
    if time.monotonic() < _wanted[1] + WAIT:
        return True
    _wanted.clear()
    try:
        begin(context, obj)
    except SplatError as error:  # an attribute was deleted
        known.of(obj).estimate = inputs, {"error": str(error)}
    return False
