"""The menu of methods: its names and sentences, and that a file keeps its method."""

from __future__ import annotations

import bpy
import pytest
from extension import DATA, part
from job_helpers import drawn, set_up


@pytest.fixture
def settings():
    settings = bpy.context.scene.svrgs_prune
    for name in ("method", "goal", "lambda_f"):
        settings.property_unset(name)
    return settings


def save_and_open(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    return bpy.context.scene.svrgs_prune


def test_the_menu_begins_with_the_default_and_the_papers_method(settings):
    items = list(settings.bl_rna.properties["method"].enum_items)
    assert [(item.identifier, item.name) for item in items[:2]] == [
        ("removal", "Recommended"),
        ("svr", "SVR-GS (paper)"),
    ]
    assert settings.method == "removal"
    assert len({item.value for item in items}) == len(items)
    assert all("λ_F" in item.description for item in items[:2])


def test_every_method_has_a_name_and_a_sentence_of_its_own(settings):
    items = list(settings.bl_rna.properties["method"].enum_items)
    assert len({item.name for item in items}) == len({item.description for item in items}) == len(items) == 27
    assert not [item.name for item in items if item.name == item.identifier or not item.name[0].isupper()]


def test_the_short_menu_shows_and_sets_the_method(splat):
    settings = bpy.context.scene.svrgs_prune
    assert [item.name for item in settings.bl_rna.properties["method_choice"].enum_items] == [
        "Recommended",
        "SVR-GS (paper)",
        "Other…",
    ]
    for choice, method in (("PAPER", "svr"), ("OTHER", "maskgs"), ("RECOMMENDED", "removal")):
        settings.method_choice = choice
        assert settings.method == method and settings.method_choice == choice
    settings.method = "pup"
    settings.method_choice = "OTHER"
    assert settings.method == "pup", "a method that was chosen already stays"
    assert "PUP 3D-GS: Removes, in one cut" in " ".join(drawn("prune").split())


def test_all_methods_are_under_advanced_with_words_that_explain_themselves(splat):
    shown = drawn("prune")
    assert "Advanced" in shown and "All Methods" in shown
    settings = bpy.context.scene.svrgs_prune.bl_rna.properties
    assert settings["holdout"].name == "Hold Out Every Nth Photo"
    assert settings["min_contribution"].name == "Drop Below"
    assert settings["iterations"].description == "Steps spent deciding which Gaussians to remove"


@pytest.mark.parametrize("name", ["removal", "svr"])
def test_the_panel_says_what_the_method_does_and_what_lambda_means(splat, name):
    set_up({"method": name, "goal": "LAMBDA"})
    method = part("svrgs_addon.finetune.methods").METHODS[name]
    said = " ".join(drawn("prune").split())
    assert method.help[1:] in said and method.help[0].upper() + method.help[1:] in said
    assert f"λ_F = 1e-4, the default: {method.lambda_f_help}" in said
    other = part("svrgs_addon.finetune.methods").METHODS[{"removal": "svr", "svr": "removal"}[name]]
    assert other.help[1:] not in said and other.lambda_f_help not in said
    bpy.context.scene.svrgs_prune.goal = "SHARE"
    assert method.help[1:] in drawn("prune") and method.lambda_f_help not in drawn("prune")


def test_a_file_keeps_its_goal_and_its_method(settings, tmp_path):
    settings.method = "svr"
    settings = save_and_open(tmp_path)
    assert (settings.goal, settings.method) == ("BALANCED", "svr")


def test_the_operator_for_scripts_takes_the_names_of_the_command_line():
    methods = bpy.ops.svrgs.prune.get_rna_type().properties["method"].enum_items
    assert {"removal", "svr", "saliency"} <= set(methods.keys())
    assert not {"svr-mask", "svr-worth"} & set(methods.keys())
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    with pytest.raises(TypeError, match="svr-worth"):
        bpy.ops.svrgs.prune(method="svr-worth")
