"""Splats as objects, with keys: Apply and Join seen with F12, cameras of another capture, File > New, saved
and moved files.

Writes what it saw to OUT/seen.json.
"""

from __future__ import annotations

import importlib
import json
import shutil
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).parents[2]))
sys.path.insert(0, str(Path(__file__).parents[2] / "benchmarks"))
sys.path.insert(0, str(Path(__file__).parent))

import bpy
import driver
from driver import DATA, OUT, key, shot, until
from mathutils import Euler, Matrix

from svrgs_bench import scenes

PACKAGE = "bl_ext.user_default.svrgs"
VIEW = (400, 600)  # somewhere in the 3D view


def part(name: str):
    return importlib.import_module(f"{PACKAGE}.{name}")


def activate(*objects):
    bpy.ops.object.select_all(action="DESELECT")
    for obj in reversed(objects):
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj


def f12(name: str):
    """Renders with the key into OUT/NAME.png."""
    done = []
    finished = lambda *_: done.append(True)
    bpy.app.handlers.render_complete.append(finished)
    yield from key("F12", *VIEW)
    yield from until(lambda: done, "F12", 60)
    bpy.app.handlers.render_complete.remove(finished)
    yield 0.3
    bpy.data.images["Render Result"].save_render(str(OUT / f"{name}.png"))


def load() -> tuple[bpy.types.Object, bpy.types.Object]:
    """Two splats, one of them turned and scaled, and a camera that sees both."""
    bpy.ops.object.select_all(action="SELECT")
    bpy.ops.object.delete()
    scene = bpy.context.scene
    scene.render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    scene.render.resolution_x, scene.render.resolution_y = 320, 240
    bpy.context.preferences.view.render_display_type = "NONE"
    splats = []
    for _ in range(2):
        bpy.ops.svrgs.import_ply(filepath=str(DATA / "scene.ply"))
        splats.append(bpy.context.object)
    splats[1].matrix_world = (
        Matrix.LocRotScale((1.5, 0.3, 0.2), Euler((0.5, 0.7, 1.1)), (1.6, 1.6, 1.6)) @ splats[1].matrix_world
    )
    camera = scene.camera = bpy.data.objects.new("camera", bpy.data.cameras.new("camera"))
    scene.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (0.7, -6, 0), (1.5708, 0, 0)
    return splats[0], splats[1]


def apply_and_join(a, b, seen: dict):
    transforms = part("operators.scene.splat_transforms")
    yield from f12("before")
    activate(b)
    yield from key("A", *VIEW, ctrl=True)  # the menu Apply
    yield from key("A", *VIEW)  # All Transforms
    yield from until(lambda: b.matrix_world == Matrix(), "Apply All Transforms")
    yield 0.5
    seen["moved"] = transforms.moved_count(b)
    shot("applied")
    yield from f12("applied")
    activate(a, b)
    yield from key("J", *VIEW, ctrl=True)
    yield from until(
        lambda: len([obj for obj in bpy.context.scene.objects if obj.type == "POINTCLOUD"]) == 1, "Join"
    )
    yield 0.5
    yield from f12("joined")
    seen["joined"] = part("operators.data.splat_object").count(a)
    yield from key("Z", *VIEW, ctrl=True)
    yield from until(
        lambda: len([obj for obj in bpy.context.scene.objects if obj.type == "POINTCLOUD"]) == 2,
        "the undoing of Join",
    )


def cameras_of_another_capture(seen: dict):
    """The tiny splat fits its cameras; a room does not."""

    def said():
        return "\n".join(part("operators.jobs.prune_state").sentences(bpy.context))

    a = next(obj for obj in bpy.context.scene.objects if obj.type == "POINTCLOUD")
    activate(a)
    bpy.ops.svrgs.import_colmap(directory=str(DATA))
    activate(a)
    known = part("operators.data.known").of(a)
    yield from until(lambda: said() is not None and known.cameras_checked[0], "the check of the cameras", 60)
    seen["own"] = said()
    bridge, scene = part("operators.data.splat_object"), scenes.room(2000)
    other = bridge.object_from_scene("other", scene, bpy.context.scene.collection)
    activate(other)
    root = next(obj for obj in bpy.context.scene.objects if bridge.ROOT in obj)
    bpy.ops.svrgs.use_cameras(root=root.name)
    yield from until(lambda: "another capture" in said(), "the sentence on other cameras", 60)
    yield 0.5
    shot("other-cameras")
    bpy.ops.svrgs.part_from_cameras()
    seen["parted"] = bridge.root_of(other) is None


def save_move_and_reload(seen: dict):
    """The .blend and its dataset are moved together."""
    folder = OUT / "project"
    shutil.rmtree(folder, ignore_errors=True)
    shutil.rmtree(OUT / "moved", ignore_errors=True)
    shutil.copytree(DATA, folder / "dataset")
    bpy.ops.wm.read_homefile(app_template="")
    yield 1.0
    bpy.ops.svrgs.import_ply(filepath=str(folder / "dataset/scene.ply"))
    bpy.ops.wm.save_as_mainfile(filepath=str(folder / "scene.blend"))
    bpy.ops.svrgs.import_colmap(directory=str(folder / "dataset"))
    bpy.ops.svrgs.spatial_mask()
    bpy.ops.wm.save_mainfile()
    yield 0.5
    (OUT / "project").rename(OUT / "moved")
    bpy.ops.wm.open_mainfile(filepath=str(OUT / "moved/scene.blend"))
    yield 1.0
    camera = bpy.context.scene.camera
    photo = camera.data.background_images[0].image
    mask = bpy.data.images["SVR-GS Spatial Mask"]
    seen["reloaded"] = {
        "photo": list(photo.size),
        "mask": max(mask.pixels[:4000]),
        "dataset": part("operators.scene.dataset_paths").dataset_of(bpy.context)[0],
    }
    shot("reloaded")


def new_file_during_a_job(seen: dict):
    watch = part("operators.jobs.job_watch")
    splat = next(
        obj for obj in bpy.context.scene.objects if part("operators.data.splat_object").is_splat(obj)
    )
    activate(splat)
    settings = bpy.context.scene.svrgs_prune
    settings.iterations, settings.recovery = 9000, 0
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    yield from until(lambda: job.facts.get("iteration", 0) > 10, "a running job", 60)
    bpy.ops.wm.read_homefile(app_template="")
    yield 1.0
    seen["after_new"] = [job.running, str(job.folder.path) in watch.jobs]
    yield from driver.sidebar("SVR-GS")
    shot("jobs")
    job.stop()
    yield from until(lambda: not job.running, "the stop", 30)
    seen["stopped"] = job.state


def steps():
    seen: dict = {"out": str(OUT)}
    a, b = load()
    yield 0.5
    yield from driver.sidebar("SVR-GS")
    yield from apply_and_join(a, b, seen)
    yield from cameras_of_another_capture(seen)
    yield from save_move_and_reload(seen)
    yield from new_file_during_a_job(seen)
    (OUT / "seen.json").write_text(json.dumps(seen))


driver.run(steps())
