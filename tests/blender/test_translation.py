"""Every text that a user sees is in the catalogues, and nothing else is. The panels show no text that is not
translated."""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from types import SimpleNamespace

import bpy
import pytest
from extension import PACKAGE, part
from job_helpers import LONG, SHORT, draw_panel, follow, set_up
from messages import catalogues, messages_of, of_jobs

KINDS = (
    bpy.types.Operator,
    bpy.types.Panel,
    bpy.types.PropertyGroup,
    bpy.types.AddonPreferences,
    bpy.types.RenderEngine,
    bpy.types.FileHandler,
)


def classes() -> Iterator[type]:
    """The registered classes of the extension."""
    for name, module in sorted(sys.modules.items()):
        if name.startswith(PACKAGE) and module is not None:
            for found in vars(module).values():
                if (
                    isinstance(found, type)
                    and issubclass(found, KINDS)
                    and found.__module__ == name
                    and found.is_registered
                ):
                    yield found


def rna_of(cls: type):
    """Blender's description of a class; of an operator that with its properties."""
    return (
        getattr(bpy.ops.svrgs, cls.bl_idname.split(".")[1]).get_rna_type()
        if issubclass(cls, bpy.types.Operator)
        else cls.bl_rna
    )


def declared(cls: type) -> Iterator[bpy.types.Property]:
    """The properties that the extension gives to a class, apart from those that no panel shows: hidden ones,
    and those without a name."""
    names = {
        name
        for base in cls.__mro__
        if base.__module__.startswith(PACKAGE)
        for name in vars(base).get("__annotations__", ())
    }
    properties = rna_of(cls).properties
    yield from (
        properties[name]
        for name in sorted(names)
        if name in properties and not properties[name].is_hidden and properties[name].name != name
    )


def texts_of(prop: bpy.types.Property) -> Iterator[str]:
    yield from (prop.name, prop.description)
    for item in prop.enum_items if prop.type == "ENUM" else ():
        yield from (item.name, item.description)


def told_to_blender() -> set[str]:
    """Labels and descriptions of the classes and properties."""
    tools = part("operators.view.select_region").TOOLS  # Blender registers them as its own toolbar does
    found = {
        getattr(cls, name, "")
        for cls in (*classes(), *tools)
        for name in ("bl_label", "bl_description", "bl_category")
    }
    found |= {
        text
        for cls in classes()
        if not issubclass(cls, bpy.types.Panel)
        for prop in declared(cls)
        for text in texts_of(prop)
    }
    found |= set(texts_of(bpy.types.Object.bl_rna.properties["svrgs_share"]))
    return found - {""}


def of_methods() -> set[str]:
    """Texts of svrgs_addon that the panel translates where it shows them."""
    options = part("operators.data.option_properties")
    return {
        text
        for m in part("svrgs_addon.finetune.methods").METHODS.values()
        for text in (m.label, options.capitalised(m.help), m.lambda_f_help)
        if text
    }


def test_the_catalogues_hold_exactly_the_texts_that_are_shown(installed):
    shown = told_to_blender() | of_methods() | messages_of(installed) | of_jobs(installed)
    assert len(shown) > 300
    for locale, texts in catalogues(installed).items():
        assert sorted(shown - texts.keys()) == [], f"not in {locale}.json"
        assert sorted(texts.keys() - shown) == [], f"{locale}.json: not used any more"


# --- panels in a language of which it is known what is translated


class Layout:
    """Notes the texts that a panel draws, as Blender would show them: each text of the catalogues in
    brackets."""

    def __init__(self, known: set[str], shown: list[str]):
        self.__dict__.update(known=known, shown=shown)

    def __getattr__(self, name):
        def draw(*words, text="", translate=True, **options):
            if text:
                self.shown.append(f"⟦{text}⟧" if translate and text in self.known else text)
            if name in ("panel", "panel_prop"):
                return Layout(self.known, self.shown), Layout(self.known, self.shown)
            return (
                Layout(self.known, self.shown)
                if name in ("row", "column", "box", "grid_flow", "split")
                else SimpleNamespace()
            )

        return draw

    def __setattr__(self, name, value):
        pass


@pytest.fixture
def drawn(installed, monkeypatch):
    """What a panel shows, in one line."""
    known = set(catalogues(installed)["de_DE"])
    for module in [
        module for name, module in sys.modules.items() if name.startswith(PACKAGE) and hasattr(module, "tr")
    ]:
        monkeypatch.setattr(module, "tr", lambda text, *_: f"⟦{text}⟧" if text in known else text)

    def draw(panel: str) -> str:
        shown: list[str] = []
        draw_panel(part(f"panels.{panel}"), Layout(known, shown))
        return " ".join(shown)

    return draw


# of objects and files of the tests, of measures and units
NAMES = re.compile(r"\b(scene|room|camera|pruned|PSNR|SSIM|FLIP|MB|kB|SPZ|bytes|svr|paper)\b")


def untranslated(shown: str) -> list[str]:
    """Words of two letters or more outside of all brackets, but for NAMES."""
    while "⟦" in shown:
        before, shown = shown, re.sub(r"⟦[^⟦⟧]*⟧", "", shown)
        assert before != shown, shown
    return re.findall(r"[^\W\d_]{2,}", NAMES.sub("", shown))


def test_untranslated_words_are_found():
    assert untranslated("⟦Kept⟧ 3 Gaussians ⟦about ⟦Method⟧ x⟧, scene: PSNR 3.1 Decibel") == [
        "Gaussians",
        "Decibel",
    ]


def test_panels_and_reports_show_translated_texts(drawn, splat, room, camera, capfd):
    bpy.ops.svrgs.spatial_mask()
    bpy.context.scene.svrgs_view.pruned = room
    bpy.ops.svrgs.compare()
    bpy.context.view_layer.objects.active = splat
    bpy.context.scene.render.engine = "BLENDER_WORKBENCH"
    bpy.context.scene.view_settings.view_transform = "AgX"
    for panel in ("scene", "spatial_mask", "compare", "export", "rendering"):
        assert "⟦" in drawn(panel) and not untranslated(drawn(panel)), panel
    reports = re.findall(r"(?:Info|Warning|Error): (.*)", capfd.readouterr().out)
    assert len(reports) == 2 and not untranslated(" ".join(reports))


def check_panels(drawn, stage: str):
    assert part("operators.jobs.prune_state").stage(bpy.context) == stage
    for panel in ("prune", "jobs"):
        assert "⟦" in drawn(panel) and not untranslated(drawn(panel)), (panel, stage)


@pytest.mark.parametrize("goal", ["BALANCED", "SMALL", "SHARE", "COUNT", "SIZE", "DROP", "LAMBDA"])
@pytest.mark.parametrize("method", ["removal", "svr", "maskgs", "gns", "opacity"])
def test_settings_are_translated_for_every_method_and_goal(drawn, splat, method, goal):
    settings = bpy.context.scene.svrgs_prune
    settings.method, settings.goal = method, goal
    check_panels(drawn, "READY")
    settings.lambda_f = 3e-4
    check_panels(drawn, "READY")


def test_jobs_are_translated_from_the_estimate_to_the_result(drawn, splat, watch, capfd):
    set_up(SHORT)
    bpy.ops.svrgs.estimate()
    check_panels(drawn, "READY")
    set_up(LONG)
    bpy.ops.svrgs.job_start()
    job = watch.current(bpy.context)[1]
    follow(watch, lambda: job.facts.get("iteration", 0) > 5)
    check_panels(drawn, "BUSY")
    bpy.ops.svrgs.job_stop()
    check_panels(drawn, "BUSY")
    follow(watch, lambda: not job.running)
    check_panels(drawn, "WAITING")
    bpy.ops.svrgs.job_discard()
    set_up(SHORT)
    bpy.ops.svrgs.job_start()
    follow(watch, lambda: len(bpy.data.objects) == 2)
    check_panels(drawn, "RESULT")
    bpy.ops.svrgs.apply()
    check_panels(drawn, "READY")
    reports = re.findall(r"(?:Info|Warning|Error): (.*)", capfd.readouterr().out)
    assert len(reports) == 6 and not untranslated(" ".join(reports))


def test_lines_of_chinese_fit_and_do_not_begin_with_a_mark():
    shown: list[str] = []
    sentence = "请选择泼溅照片的数据集，或在第 1 步导入其摄像机。" * 6
    wrapped_label = part("panels.sidebar")
    wrapped_label.wrapped_label(Layout(set(), shown), sentence)
    widths = [sum(1 + (character > "\u2fff") for character in line) for line in shown]
    assert len(shown) > 5 and max(widths) <= wrapped_label.SIDEBAR_WIDTH / wrapped_label.CHARACTER_WIDTH
    assert "".join(shown).replace(" ", "") == sentence.replace(" ", "")
    assert not [line for line in shown if line[0] in "，。"]
