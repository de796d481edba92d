"""The menu of methods: its names and sentences, what old files and jobs hold, and that a renamed method is
said once."""

from __future__ import annotations

import json
from types import SimpleNamespace

import bpy
import pytest
from extension import DATA, part
from job_helpers import LONG, SHORT, Layout, drawn, follow, set_up

RENAMED = [  # number in the menu, name now, sentence
    (0, "removal", "Method 'svr' of this file is called 'Recommended' now ('removal' on the command line)"),
    (1, "svr", "Method 'svr-mask' of this file is called 'SVR-GS (paper)' now ('svr' on the command line)"),
    (
        6,
        "saliency",
        "Method 'svr-worth' of this file is called 'Saliency' now ('saliency' on the command line)",
    ),
]


@pytest.fixture
def settings():
    settings = bpy.context.scene.svrgs_prune
    for name in ("method", "method_schema", "goal", "strength"):
        settings.property_unset(name)
    return settings


def save_and_open(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "work.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    return bpy.context.scene.svrgs_prune


def choose_in_old_version(settings, number: int):
    """As a file of an earlier version holds the method: its number, and no method_schema."""
    settings["method"] = number


def note() -> str:
    return bpy.context.window_manager.svrgs_prune_state.method_renamed


def test_the_menu_begins_with_the_default_and_the_papers_method(settings):
    items = list(settings.bl_rna.properties["method"].enum_items)
    assert [(item.identifier, item.name) for item in items[:2]] == [
        ("removal", "Recommended"),
        ("svr", "SVR-GS (paper)"),
    ]
    assert settings.method == "removal"
    assert len({item.value for item in items}) == len(items) and all(
        "λ_F" in item.description for item in items[:2]
    )


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
        assert settings.method == method and settings.method_choice == choice and settings.method_schema == 2
    settings.method = "pup"
    settings.method_choice = "OTHER"
    assert settings.method == "pup", "a method that was chosen already stays"
    assert "PUP 3D-GS: Removes, in one cut" in " ".join(drawn("prune").split())


def test_all_methods_are_under_advanced_with_words_that_explain_themselves(splat):
    layout, panel = Layout(), part("panels.prune").SVRGS_PT_prune_advanced
    panel.draw(SimpleNamespace(layout=layout), bpy.context)
    assert "All Methods" in layout.text and panel.poll(bpy.context)
    settings = bpy.context.scene.svrgs_prune.bl_rna.properties
    assert (settings["holdout"].name, settings["min_contribution"].name) == (
        "Hold Out Every Nth Photo",
        "Drop Below",
    )
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


@pytest.mark.parametrize("number, name, sentence", RENAMED)
def test_an_old_file_keeps_its_method_and_says_once_what_it_is_called_now(
    splat, settings, tmp_path, capfd, number, name, sentence
):
    choose_in_old_version(settings, number)
    settings = save_and_open(tmp_path)
    assert settings.method == name and settings.method_schema == 2
    assert note() == sentence and sentence in " ".join(drawn("prune").split())
    assert capfd.readouterr().out.count(f"SVR-GS: {sentence}\n") == 1
    settings = save_and_open(tmp_path)
    assert (
        settings.method == name
        and note() == ""
        and "is called" not in capfd.readouterr().out + drawn("prune")
    )


def test_a_file_that_was_not_saved_says_it_again(settings, tmp_path, capfd):
    choose_in_old_version(settings, 1)
    save_and_open(tmp_path)
    capfd.readouterr()
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "work.blend"))
    assert capfd.readouterr().out.count("is called") == 1 and note()


def test_choosing_a_method_ends_the_note(settings, tmp_path):
    choose_in_old_version(settings, 1)
    settings = save_and_open(tmp_path)
    assert note()
    settings.method = "maskgs"
    assert not note()


@pytest.mark.parametrize("choice", ["never set", "set now", "never renamed"])
def test_other_files_say_nothing(settings, tmp_path, capfd, choice):
    if choice == "set now":
        settings.method = "svr"
        assert settings.method_schema == 2
    elif choice == "never renamed":
        choose_in_old_version(settings, 7)
    expected = settings.method
    settings = save_and_open(tmp_path)
    assert settings.method == expected and not note() and "is called" not in capfd.readouterr().out
    assert settings.method_schema == (2 if choice != "never set" else 0)


@pytest.mark.parametrize(
    "stored, goal",
    [({}, "BALANCED"), ({"method": 13}, "LAMBDA"), ({"strength": -3.5}, "LAMBDA"), ({"goal": 1}, "SHARE")],
)
def test_an_old_file_keeps_its_goal(settings, tmp_path, stored, goal):
    """The default goal was the strength."""
    for name, value in stored.items():
        settings[name] = value
    settings = save_and_open(tmp_path)
    assert settings.goal == goal and settings.lambda_f == pytest.approx(10 ** stored.get("strength", -4))
    assert save_and_open(tmp_path).goal == goal


def test_a_file_of_this_version_keeps_its_goal(settings, tmp_path):
    settings.method = "svr"
    assert save_and_open(tmp_path).goal == "BALANCED"


def test_every_scene_of_a_file_has_its_own_note(settings, tmp_path, capfd):
    choose_in_old_version(settings, 0)
    for number in (1, 1):
        choose_in_old_version(bpy.data.scenes.new("other").svrgs_prune, number)
    save_and_open(tmp_path)
    sentences = {part("operators.jobs.former_methods").sentence_of(scene) for scene in bpy.data.scenes}
    assert sentences == {RENAMED[0][2], RENAMED[1][2]} and capfd.readouterr().out.count("is called") == 2
    for scene in list(bpy.data.scenes)[1:]:
        bpy.data.scenes.remove(scene)
    assert not bpy.data.scenes[1:]


def test_every_former_name_has_a_sentence():
    former = part("svrgs_addon.finetune.methods").FORMER_NAMES
    methods = part("svrgs_addon.finetune.methods").METHODS
    assert {methods[name].number: name for name in former.values()} == {
        number: name for number, name, _ in RENAMED
    }


@pytest.mark.parametrize(
    "former, name", [("svr", "removal"), ("svr-mask", "svr"), ("svr-worth", "saliency"), (None, "removal")]
)
def test_a_job_of_the_first_schema_is_resumed_with_its_method(splat, watch, results, capfd, former, name):
    """former None: a job that does not name its method has the default of that time, which is svr."""
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    request = json.loads((job.folder / "job.json").read_text())
    options = {**request["options"], "iterations": 20, "recovery": 5, "method": former}
    if former is None:
        del options["method"]
    job.folder.write_json("job.json", {**request, "schema": 1, "options": options})
    capfd.readouterr()
    bpy.ops.svrgs.job_resume()
    sentence = f"Method '{former or 'svr'}' is called '{name}' now"
    assert f"Pruning of 'scene' continues. {sentence}" in capfd.readouterr().out
    follow(watch, lambda: results.pruned_of(splat))
    request = json.loads((job.folder / "job.json").read_text())
    assert request["schema"] == 2 and request["options"]["method"] == name, job.folder.result()


def test_a_job_of_this_version_says_nothing_when_resumed(splat, watch, capfd):
    set_up(SHORT | {"iterations": 2000})
    bpy.ops.svrgs.job_start()
    (job,) = watch.jobs.values()
    bpy.ops.svrgs.job_stop()
    follow(watch, lambda: not job.running)
    bpy.ops.svrgs.job_resume()
    said = capfd.readouterr().out
    assert "Pruning of 'scene' continues" in said and "is called" not in said and not job.renamed


def test_the_operator_for_scripts_takes_the_names_of_the_command_line():
    methods = bpy.ops.svrgs.prune.get_rna_type().properties["method"].enum_items
    assert {"removal", "svr", "saliency"} <= set(methods.keys()) and not {"svr-mask", "svr-worth"} & set(
        methods.keys()
    )
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    with pytest.raises(TypeError, match="svr-worth"):
        bpy.ops.svrgs.prune(method="svr-worth")
