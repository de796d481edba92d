"""The steps of the sidebar: which of them is open."""

from __future__ import annotations

import bpy
from extension import DATA, part
from job_helpers import SHORT, drawn, ended, follow, set_up

NAMES = ("train", "prune", "compare", "export")


def opened() -> list[str]:
    return [name for name in NAMES if getattr(bpy.context.window_manager.svrgs_steps, name)]


def ready() -> list[str]:
    """The steps that have something to do."""
    return [name for name in NAMES if part(f"panels.{name}").has_something(bpy.context)]


def test_the_step_that_has_something_to_do_is_open(watch, tmp_path):
    assert opened() == [] and ready() == []
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert opened() == ["train"] == ready()
    assert "Train the splat first" in drawn("prune")
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    assert opened() == ["prune"] and ready() == ["prune", "export"]
    assert "Import cameras first" in drawn("train")
    set_up(SHORT | {"data": str(DATA / "tiny"), "folder": str(tmp_path / "jobs")})
    bpy.ops.svrgs.job_start()
    assert opened() == ["prune"]
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    assert opened() == ["prune"] and ready() == ["prune", "compare", "export"]
    bpy.ops.svrgs.apply()
    assert opened() == ["export"]


def test_one_is_open_that_the_user_chose_until_something_happens():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    steps = bpy.context.window_manager.svrgs_steps
    steps.export = True
    assert opened() == ["export"]
    steps.compare = True
    assert opened() == ["compare"]
    steps.compare = False
    assert opened() == []
    steps.export = True
    bpy.data.objects.remove(bpy.context.object)
    assert opened() == []
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    assert opened() == ["prune"], "another splat"
