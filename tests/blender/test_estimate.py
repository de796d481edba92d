"""What the panel says of an estimate."""

from __future__ import annotations

import re
import shutil

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import LONG, drawn, follow, said, set_up


def test_an_estimate_is_shown_only_beside_what_it_was_made_for(bridge):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat, settings = bpy.context.object, bpy.context.scene.svrgs_prune
    settings.data = str(DATA / "tiny")
    settings.goal, settings.method = "LAMBDA", "removal"
    bpy.ops.svrgs.estimate()
    for name, other in (("method", "maskgs"), ("goal", "SHARE"), ("lambda_f", 1e-5), ("recovery", 7)):
        before = getattr(settings, name)
        assert "would stay" in said()
        setattr(settings, name, other)
        assert "would stay" not in said(), name
        setattr(settings, name, before)
    assert part("operators.jobs.estimate").of(splat)["count"] == 250
    bridge.replace_gaussians(splat, bridge.scene_from_object(splat).select(np.arange(99)))
    assert "would stay" not in said()


def test_it_says_how_good_the_result_would_be():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat, settings = bpy.context.object, bpy.context.scene.svrgs_prune
    settings.data = str(DATA / "tiny")
    settings.method, settings.goal, settings.share = "removal", "SHARE", 20
    bpy.ops.svrgs.estimate()
    found = part("operators.jobs.estimate").of(splat)
    before, removed, after = (found[f"psnr_{name}"] for name in ("before", "removed", "after"))
    assert removed < after <= before
    assert (
        f"PSNR about {after:.1f} dB or more after pruning (now {before:.1f} dB; without recovery about"
        f" {removed:.1f} dB)" in said()
    )
    settings.method = "opacity"
    bpy.ops.svrgs.estimate()
    assert f"PSNR now {before:.1f} dB; after pruning: not foreseen for this method or goal" in said()


def test_a_limit_of_time_chooses_the_steps():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat, settings = bpy.context.object, bpy.context.scene.svrgs_prune
    settings.data = str(DATA / "tiny")
    settings.method, settings.goal, settings.share = "removal", "SHARE", 20
    assert "use_time" in drawn("prune") and not re.search(r"\btime\b", drawn("prune"))
    bpy.ops.svrgs.estimate()
    assert part("operators.jobs.estimate").of(splat)["steps"] == 8_000 and "for 8,000 steps" in said()
    settings.use_time, settings.time = True, 3600
    assert re.search(r"\btime\b", drawn("prune"))
    options = part("operators.jobs.job").options_of(bpy.context, splat)
    assert options["time"] == 3600 and not {"iterations", "recovery"} & options.keys()
    assert "would stay" not in said(), "the estimate was for all steps"
    bpy.ops.svrgs.estimate()
    assert part("operators.jobs.estimate").of(splat)["schedule"] == 1, "it is enough for all steps"
    settings.use_time = False  # the scene is that of the other tests, too


MISSING = "1 of 12 photographs are missing: 05.png; the other 11 are used"


def test_it_begins_by_itself_once_the_settings_have_rested(splat, monkeypatch):
    """As with a window: a timer looks at them."""
    work, estimate = part("operators.data.background_work"), part("operators.jobs.estimate")
    settings, begun = bpy.context.scene.svrgs_prune, []
    monkeypatch.setattr(work, "waits", False)
    monkeypatch.setattr(estimate, "WAIT", 3600)
    monkeypatch.setattr(estimate, "begin", lambda context, obj: begun.append(settings.share))
    settings.goal = "SHARE"
    for share in (20, 30):
        settings.share = share
        assert "job_start" in drawn("prune") and work.tick() and not begun
    monkeypatch.setattr(estimate, "WAIT", 0)
    while work.tick() is not None:  # the check of the cameras, too
        pass
    assert begun == [30]


def test_any_error_ends_it(splat, monkeypatch, capfd):
    module = part("operators.jobs.estimate")

    def fail(*_):
        raise MemoryError

    monkeypatch.setattr(module, "write_scene", fail)
    with pytest.raises(RuntimeError, match="MemoryError"):
        bpy.ops.svrgs.estimate()
    assert module.of(splat) == {"error": "MemoryError"} and "MemoryError" in said()
    monkeypatch.undo()
    assert bpy.ops.svrgs.estimate() == {"FINISHED"}


def test_missing_photographs_are_said_beside_the_estimate_and_while_a_job_runs(splat, watch, tmp_path):
    shutil.copytree(DATA / "tiny", tmp_path / "data")
    (tmp_path / "data/images/05.png").unlink()
    set_up(LONG | {"data": str(tmp_path / "data"), "method": "removal"})
    bpy.ops.svrgs.estimate()
    assert "would stay" in said() and MISSING in said()
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: job.facts.get("iteration"))
    assert MISSING in said()
