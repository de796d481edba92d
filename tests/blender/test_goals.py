"""The goals of the prune panel: what they ask of a job, and what the panel says of them; the file size that
is foreseen."""

from __future__ import annotations

import bpy
import pytest
from extension import DATA, part
from job_helpers import drawn, ended, follow, set_up

GOALS = ("lambda_f", "target_count", "target_size", "target_format", "max_drop", "max_lpips")


def options(splat) -> dict:
    """What a job is asked for, of GOALS."""
    found = part("operators.jobs.job").options_of(bpy.context, splat)
    return {name: found[name] for name in GOALS if name in found}


def test_light_balanced_and_small_come_first_and_balanced_is_the_default(splat):
    goals = bpy.context.scene.svrgs_prune.bl_rna.properties["goal"]
    assert [item.name for item in goals.enum_items][:3] == ["Light", "Balanced", "Small"]
    assert goals.default == "BALANCED"
    assert len({item.value for item in goals.enum_items}) == len(goals.enum_items)
    assert [goals.enum_items[name].value for name in ("LAMBDA", "SHARE", "COUNT", "SIZE", "DROP")] == [
        0,
        1,
        2,
        3,
        4,
    ], "stored in files of earlier versions"


@pytest.mark.parametrize(
    "method, expected",
    [
        ("removal", [{"lambda_f": 1e-5}, {}, {"lambda_f": 1e-3}]),
        ("saliency", [{"lambda_f": 1e-5}, {}, {"lambda_f": 1e-3}]),
        ("gns", [{"target_count": 125}, {}, {"target_count": 42}]),
        ("opacity", [{"target_count": 125}, {"target_count": 62}, {"target_count": 42}]),
    ],
)
def test_the_plain_goals_are_multiples_of_the_default_strength_or_shares(splat, method, expected):
    for goal, wanted in zip(("LIGHT", "BALANCED", "SMALL"), expected, strict=True):
        set_up({"method": method, "goal": goal})
        assert options(splat) == pytest.approx(wanted)
        assert bpy.ops.svrgs.job_start.poll()
        assert ("Keeps" in drawn("prune")) == ("target_count" in wanted or method == "gns")
        assert "amount" not in drawn("prune")


@pytest.mark.parametrize(
    "method, goal, sentence",
    [
        ("removal", "BALANCED", "with little loss"), ("svr", "BALANCED",
        "The default λ_F of this method"),
        ("svr", "LIGHT", "0.1 times the default λ_F of this method"), ("gns", "BALANCED",
        "Keeps 25% of the Gaussians"),
        ("maskgs", "BALANCED", "The method's own weight decides"), ("maskgs", "SMALL",
        "Keeps 17% of the Gaussians"),
    ],
)  # fmt: skip
def test_the_panel_promises_only_what_was_measured(splat, method, goal, sentence):
    set_up({"method": method, "goal": goal})
    assert sentence in " ".join(drawn("prune").split())


def test_balanced_is_what_the_default_strength_is(splat):
    set_up({"method": "removal", "goal": "LAMBDA"})
    strength = options(splat)
    plan = part("svrgs_addon.prune.plans").plan_of_pruning
    make = part("svrgs_addon.prune.options").PruneOptions
    assert plan(make(method="removal", **strength)) == plan(make(method="removal"))
    assert strength == {"lambda_f": 1e-4}


@pytest.mark.parametrize("degree, further", [(0, False), (1, True), (3, True), (3, False)])
@pytest.mark.parametrize("order", ["3dgs", "without normals"])
def test_the_size_that_is_foreseen_is_that_of_the_file(tmp_path, ply, make_scene, degree, further, order):
    from dataclasses import replace

    scene = make_scene(500, degree, further)
    scene = (
        scene
        if order == "3dgs"
        else replace(
            scene,
            property_order=("x", "y", "z"),
            attributes={k: v for k, v in scene.attributes.items() if k != "nx"},
        )
    )
    ply.write_ply(tmp_path / "scene.ply", scene)
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "scene.ply"))
    size = part("operators.data.splat_size").size_of(bpy.context.object, 500)
    assert size == pytest.approx((tmp_path / "scene.ply").stat().st_size, abs=8)


@pytest.mark.parametrize("kind, size", [("spz", 0.004), ("ply", 0.015)])
def test_a_file_size_as_the_goal_is_that_of_the_exported_file(splat, watch, tmp_path, kind, size):
    set_up({"effort": "QUICK", "goal": "SIZE", "size": size, "size_kind": kind})
    assert "size_kind" in drawn("prune")
    assert options(splat) == {"target_size": size, "target_format": f".{kind}"}
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    follow(watch, lambda: ended(job))
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"a.{kind}"))
    assert 0.8 * size * 1e6 < (tmp_path / f"a.{kind}").stat().st_size <= 1.05 * size * 1e6


def test_the_panels_say_the_size_of_the_file(splat):
    assert f"{(DATA / 'tiny/scene.ply').stat().st_size / 1e3:.1f} kB" in drawn("export")


def test_no_visible_change_needs_the_weights_of_lpips(splat, monkeypatch, tmp_path):
    goals, settings = part("operators.jobs.goals"), bpy.context.scene.svrgs_prune
    set_up({"goal": "VISIBLE", "effort": "PHOTOGRAPHS"})
    monkeypatch.setattr(goals, "weights_file", lambda: tmp_path / "missing")
    assert "make lpips" in goals.problem(settings)
    monkeypatch.setattr(goals, "weights_file", lambda: DATA / "tiny/scene.ply")  # any file
    assert goals.problem(settings) == "" and options(splat) == {"max_lpips": 0.01}
    settings.method = "svr"
    assert "cannot hold LPIPS" in goals.problem(settings)
