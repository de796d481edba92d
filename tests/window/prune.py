"""See the estimate, prune, stop, go on, look at fewer, apply and undo, with the mouse. Writes what it saw to
OUT/seen.json."""

from __future__ import annotations

import importlib
import json
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
from driver import DATA, OUT, click, key, shot, until

PACKAGE = "bl_ext.user_default.svrgs"
LEFT, RIGHT = 842, 961  # the two buttons of a row
START, STOP, RESUME, APPLY = 267, 339, 292, 156  # distances of these rows below the header
VIEW = (400, 700)  # somewhere in the 3D view


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def load() -> str:
    """The name of the splat, with its dataset and settings for a job."""
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "scene.ply"))
    splat = bpy.context.object.name
    bpy.ops.svrgs.import_colmap(directory=str(DATA))
    bpy.context.view_layer.objects.active = bpy.data.objects[splat]
    settings = bpy.context.scene.svrgs_prune
    settings.iterations, settings.recovery, settings.goal, settings.share = 6000, 3000, "SHARE", 40
    settings.folder = str(OUT / "jobs")
    bpy.ops.ed.undo_push(message="Ready")
    return splat


def ask_for_estimate(splat: str, seen: dict):
    estimate = part("operators.jobs.estimate")
    yield from until(lambda: "kept" in estimate.of(bpy.data.objects[splat]), "an estimate")
    yield 0.5
    seen["estimate"] = estimate.sentences(bpy.data.objects[splat])
    shot("estimate")


def start_and_stop(seen: dict):
    watch = part("operators.jobs.job_watch")
    job = lambda: watch.current(bpy.context)[1]
    yield from click(RIGHT, driver.header_height("Prune") + START)
    yield from until(job, "a job")
    yield from until(lambda: job().facts.get("iteration", 0) > 1500, "1500 iterations")
    yield 0.3
    seen["running"] = job().facts
    shot("running")
    yield from click(LEFT, driver.header_height("Prune") + STOP)
    yield from until(lambda: not job().running, "the stop")
    yield 0.5
    seen["stopped"] = dict(job().facts)
    shot("stopped")


def go_on_to_the_result(seen: dict):
    results = part("operators.jobs.job_result")
    yield from click(LEFT, driver.header_height("Prune") + RESUME)
    yield from until(lambda: "pruned" in bpy.context.object.name, "the result", 90)
    yield 0.8
    pruned, kept = bpy.context.object.name, bpy.context.object["svrgs_kept"]
    seen["result"] = [pruned, kept, results.shown_count(bpy.context.object)]
    shot("result")
    return pruned


def apply_fewer_and_undo(pruned: str, seen: dict):
    results = part("operators.jobs.job_result")
    bpy.context.object.svrgs_share = 20
    yield 0.5
    seen["fewer"] = results.shown_count(bpy.context.object)
    shot("fewer")
    bpy.ops.ed.undo_push(message="Fewer")
    yield from click(LEFT, driver.header_height("Prune") + APPLY)
    yield from until(lambda: not results.undecided(bpy.data.objects[pruned]), "Apply")
    seen["applied"] = len(bpy.data.objects[pruned].data.attributes["scale"].data)
    yield 0.5
    shot("applied")
    yield from key("Z", *VIEW, ctrl=True)
    yield from until(lambda: results.undecided(bpy.data.objects[pruned]), "the undoing of Apply")
    seen["undone"] = [
        len(bpy.data.objects[pruned].data.attributes["scale"].data),
        results.shown_count(bpy.data.objects[pruned]),
    ]


def delete_and_undo(splat: str, pruned: str, seen: dict):
    results = part("operators.jobs.job_result")
    yield from key("DEL", *VIEW)
    yield from until(lambda: pruned not in bpy.context.scene.objects, "the key Delete")
    yield 0.5
    original = bpy.data.objects[splat]
    seen["deleted"] = [original.hide_get(), results.PRUNED in original, "removed" in original.data.attributes]
    yield from key("Z", *VIEW, ctrl=True)
    yield from until(lambda: pruned in bpy.context.scene.objects, "the undoing of Delete")
    yield 0.5
    pair = bpy.data.objects[splat], bpy.data.objects[pruned]
    seen["back"] = [
        results.pair_of(pair[0]) == results.pair_of(pair[1]) == pair,
        pair[0].hide_get(),
        results.shown_count(pair[1]),
    ]


def steps():
    seen, splat = {}, load()
    yield from driver.sidebar("SVR-GS")
    yield from driver.open_panel("Prune")
    yield from ask_for_estimate(splat, seen)
    yield from start_and_stop(seen)
    pruned = yield from go_on_to_the_result(seen)
    yield from apply_fewer_and_undo(pruned, seen)
    yield from delete_and_undo(splat, pruned, seen)
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())
