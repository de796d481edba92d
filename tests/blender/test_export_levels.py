"""Levels of detail in one go: every selected splat and smaller ones of each, in any format or one streamed
SOG, without losing a file."""

from __future__ import annotations

import json
import shutil
import time
import types

import bpy
import pytest
from extension import part


@pytest.fixture
def formats():
    return part("svrgs_addon.files.registry")


def export(folder, **words):
    return bpy.ops.svrgs.export_levels(directory=str(folder), **words)


@pytest.fixture
def two(splat, bridge):
    """The tiny splat and a copy of it, both selected."""
    bpy.ops.object.duplicate()
    for obj in (splat, bpy.context.object):
        obj.select_set(True)
    return splat, bpy.context.object


def test_every_selected_splat_and_its_levels_are_written(two, formats, bridge, tmp_path):
    assert export(tmp_path, kind="spz", shares="50, 25") == {"FINISHED"}
    for obj in two:
        name, count = bpy.path.clean_name(obj.name), bridge.count(obj)
        counts = [formats.describe(tmp_path / f"{name}{end}.spz")["count"] for end in ("", "_50", "_25")]
        assert counts[0] <= count and counts[1:] == [round(counts[0] * share) for share in (0.5, 0.25)]
    said = "\n".join(part("operators.io.export_levels").lines())
    assert all(f"{obj.name}: 100 %" in said for obj in two) and "50 %" in said and "dB" in said


def test_a_splat_that_was_hidden_and_shown_is_written(splat, tmp_path):
    """It is active then, and not selected."""
    splat.hide_set(True)
    splat.hide_set(False)
    assert not bpy.context.selected_objects and bpy.context.object == splat
    assert export(tmp_path, kind="splat", shares="") == {"FINISHED"} and list(tmp_path.glob("*.splat"))


def test_a_streamed_sog_holds_all_levels(splat, formats, tmp_path):
    assert export(tmp_path, kind="streamed-sog", shares="40") == {"FINISHED"}
    path = tmp_path / bpy.path.clean_name(splat.name) / "lod-meta.json"
    assert json.loads(path.read_text())["lodLevels"] == 2 and formats.read_scene(path).count > 0


def test_without_levels_every_splat_is_written_as_it_is(two, formats, bridge, tmp_path):
    assert export(tmp_path, kind="splat", shares="") == {"FINISHED"}
    assert {file.name for file in tmp_path.glob("*.splat")} == {
        f"{bpy.path.clean_name(obj.name)}.splat" for obj in two
    }
    assert formats.describe(tmp_path / f"{bpy.path.clean_name(two[0].name)}.splat")["count"] == bridge.count(
        two[0]
    )


def test_a_file_that_is_there_is_kept_unless_overwrite_is_set(splat, tmp_path):
    path = tmp_path / f"{bpy.path.clean_name(splat.name)}_50.ply"
    path.write_text("mine")
    with pytest.raises(RuntimeError, match="exists already"):
        export(tmp_path, kind="ply", shares="50")
    assert path.read_text() == "mine" and len(list(tmp_path.glob("*.ply"))) == 1
    assert export(tmp_path, kind="ply", shares="50", overwrite=True) == {"FINISHED"}
    assert path.stat().st_size > 100


def test_another_file_does_not_show_what_was_exported_from_this_one(splat, tmp_path):
    levels = part("operators.io.export_levels")
    assert export(tmp_path, kind="ply", shares="50") == {"FINISHED"} and levels.lines()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "a.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "a.blend"))
    assert levels.lines() == []


@pytest.mark.parametrize("shares", ("0", "100", "50, x", "-3"))
def test_levels_that_are_none_are_refused(splat, shares, tmp_path):
    with pytest.raises(RuntimeError, match="between 0 and 100"):
        export(tmp_path, kind="ply", shares=shares)


def test_what_the_dialog_foresees_is_nearly_what_is_written(splat, bridge, tmp_path):
    size_in = part("operators.data.splat_size").size_in
    for kind, suffix in (
        ("ply", ".ply"),
        ("compressed-ply", ".compressed.ply"),
        ("spz", ".spz"),
        ("glb", ".glb"),
        ("splat", ".splat"),
    ):
        assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"a{suffix}"), what="STORED") == {"FINISHED"}
        size = (tmp_path / f"a{suffix}").stat().st_size / 1e6
        said = size_in(splat, bridge.count(splat), kind)
        assert float(said.split("about ")[1].split(" MB")[0]) == pytest.approx(size, abs=0.06), kind


def test_two_splats_whose_files_would_have_one_name_are_refused(splat, tmp_path):
    other = splat.copy()
    bpy.context.scene.collection.objects.link(other)
    splat.name, other.name = "a/b", "a:b"
    for obj in (splat, other):
        obj.select_set(True)
    with pytest.raises(RuntimeError, match="a_b.spz: two splats would be written into it"):
        bpy.ops.svrgs.export_levels(directory=str(tmp_path), shares="")
    assert not list(tmp_path.glob("*.spz"))


def test_levels_are_exported_after_the_temporary_folder_was_deleted(splat, tmp_path):
    shutil.rmtree(bpy.app.tempdir)
    bpy.ops.svrgs.export_levels(directory=str(tmp_path), shares="")
    assert list(tmp_path.glob("*.spz"))


@pytest.mark.parametrize("name, slow", [("export_levels", "_export"), ("export_farm", "subprocess_python")])
def test_in_a_window_a_failure_is_shown_also_where_another_file_is_open(
    splat, tmp_path, monkeypatch, name, slow
):
    module, work = part(f"operators.io.{name}"), part("operators.data.background_work")
    SceneError = part("svrgs_addon.system.errors").SceneError

    def fail(*_):
        raise SceneError("no room")

    shown = []
    monkeypatch.setattr(work, "waits", False)
    monkeypatch.setattr(module, "popup", lambda *words: shown.append(words))
    monkeypatch.setattr(module, slow, fail if slow == "_export" else types.SimpleNamespace(ask=fail))
    operator = bpy.ops.svrgs.export_levels if slow == "_export" else bpy.ops.svrgs.export_farm_job
    operator(directory=str(tmp_path))
    bpy.ops.wm.read_homefile(use_empty=True)
    while work.tick() is not None:
        time.sleep(0.02)
    assert len(shown) == 1 and "no room" in shown[0][1]
