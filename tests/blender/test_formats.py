"""Splats of every format in Blender: imported upright and with their values, exported by the suffix of the
name."""

from __future__ import annotations

import re
from pathlib import Path
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn

WRITTEN = (".ply", ".compressed.ply", ".spz", ".glb", ".usd", ".sog", ".splat")


@pytest.fixture
def formats():
    return part("svrgs_addon.files.registry")


@pytest.mark.parametrize("suffix", WRITTEN)
def test_a_file_is_imported_upright_under_its_name_and_exported_again(
    suffix, splat, formats, bridge, tmp_path
):
    assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"toy{suffix}")) == {"FINISHED"}
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / f"toy{suffix}"))
    found, source = bpy.context.object, bridge.scene_from_object(splat)
    assert found.name.startswith("toy") and "." not in found.name.removesuffix(".001")
    means = bridge.scene_from_object(found).means
    assert bridge.count(found) == bridge.count(splat)
    assert np.sort(means, axis=0) == pytest.approx(np.sort(source.means, axis=0), abs=0.02)
    assert np.allclose(found.matrix_world, splat.matrix_world)


@pytest.mark.parametrize("version", ["4", "3", "2"])
def test_an_spz_of_each_version_is_exported(version, splat, formats, tmp_path):
    assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.spz"), version=version) == {"FINISHED"}
    assert part("svrgs_addon.files.spz").streams((tmp_path / "a.spz").read_bytes(), 1_000)[0].version == int(
        version
    )


def test_a_larger_error_in_sh_makes_a_smaller_spz_and_leaves_a_ply_as_it_is(splat, bridge, tmp_path):
    sizes = {}
    for suffix in (".spz", ".ply"):
        for quantise in (0.2, 8):
            assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / f"a{suffix}"), quantise=quantise) == {
                "FINISHED"
            }
            sizes[suffix, quantise] = (tmp_path / f"a{suffix}").stat().st_size
    assert sizes[".ply", 0.2] == sizes[".ply", 8]
    assert (
        sizes[".spz", 0.2] > sizes[".spz", 8]
        if bridge.sh_degree(splat)
        else sizes[".spz", 0.2] == sizes[".spz", 8]
    )


def test_blenders_own_reader_of_gltf_takes_a_splat_for_points(splat, bridge, tmp_path):
    """It does not know the extension; its axes are those of Blender, as those of the imported splat."""
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "toy.glb"), space="WORLD")
    try:
        bpy.ops.import_scene.gltf(filepath=str(tmp_path / "toy.glb"))
    except (AttributeError, RuntimeError) as error:
        pytest.skip(f"Blender's reader of glTF is missing: {error}")
    obj = bpy.context.object  # Blender 5.3 makes a point cloud of it
    points = np.array(
        [obj.matrix_world @ point.co for point in getattr(obj.data, "vertices", None) or obj.data.points]
    )
    means = (
        bridge.scene_from_object(splat).means @ np.array(splat.matrix_world)[:3, :3].T
        + np.array(splat.matrix_world)[:3, 3]
    )
    assert np.sort(points, axis=0) == pytest.approx(np.sort(means, axis=0), abs=1e-4)


def test_a_splat_is_exported_as_spz_unless_it_came_in_another_format_than_ply(splat, tmp_path):
    export = part("operators.io.export_ply")
    assert export.default_path(splat).name == "scene.spz" and "as PLY" in drawn("export")
    assert "Imported from" not in drawn("export")
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "toy.spz"))
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "toy.spz"))
    toy, size = bpy.context.object, (tmp_path / "toy.spz").stat().st_size
    assert export.default_kind(toy) == "spz" and export.default_path(toy).name == "toy.spz"
    assert f"Imported from SPZ, {size / 1e3:.1f} kB" in drawn("export")
    toy["svrgs_format"] = 7  # a property that anybody may set
    assert export.default_kind(toy) == "spz" and "Imported from" not in drawn("export")


def test_an_spz_is_rounded_by_the_imported_cameras(splat, formats, tmp_path, monkeypatch, capfd):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    cameras = part("svrgs_addon.views.dataset").load_dataset(DATA / "tiny").cameras
    places = np.stack([camera.position for i, camera in enumerate(cameras) if i % 8])
    splat.location = (1, 2, 3)  # below the root, whose axes are those of the file
    bpy.context.view_layer.update()
    export, given = part("operators.io.export_ply"), []
    seen_from = export.seen_from
    monkeypatch.setattr(export, "seen_from", lambda *words: given.append(words) or seen_from(*words))
    for space, offset in (("FILE", 0), ("LOCAL", np.array(splat.matrix_local.translation))):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.spz"), space=space)
        scene, views, _ = given.pop()
        assert np.stack([view.position for view in views]) == pytest.approx(places - offset, abs=1e-4)
        assert formats.read_scene(tmp_path / "a.spz").count == scene.count == 250
        said = "".join(capfd.readouterr())
        assert float(re.search(r"PSNR ([0-9.]+) dB against the splat", said)[1]) > 35
    camera = next(obj for obj in bpy.data.objects if obj.type == "CAMERA" and "svrgs_size" in obj.data)
    splat.scale, camera.data.type = (1, 2, 3), "PANO"  # neither hinders an export
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "b.spz"), space="LOCAL")
    assert len(given.pop()[1]) == 9 and formats.read_scene(tmp_path / "b.spz").count == 250
    splat.scale, camera.data.type = (1, 1, 1), "PERSP"
    capfd.readouterr()
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "a.ply"))
    assert "against the splat" not in "".join(capfd.readouterr()) and given.pop()
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "plain.spz"), space="LOCAL", by_views=False)
    assert given.pop()[1] == []
    assert (tmp_path / "plain.spz").read_bytes() != (tmp_path / "a.spz").read_bytes()


def test_a_folder_that_is_not_there_is_not_made(splat, tmp_path, capfd):
    with pytest.raises(RuntimeError, match="there is no such folder"):
        bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "mistyped/toy.ply"))
    assert not (tmp_path / "mistyped").exists()
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "toy.ply"))
    assert str(tmp_path / "toy.ply") in "".join(capfd.readouterr())


def test_what_a_format_cannot_hold_is_said(splat, tmp_path, capfd):
    assert bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "toy.splat")) == {"FINISHED"}
    said = capfd.readouterr()
    assert "spherical harmonics up to degree 0" in said.out + said.err


@pytest.mark.parametrize(
    "path, kind, wanted",
    [
        ("/a/toy.ply", "spz", "/a/toy.spz"),
        ("/a/toy.ply", "compressed-ply", "/a/toy.compressed.ply"),
        ("/a/toy.compressed.ply", "ply", "/a/toy.ply"),
        ("/a/toy.v2", "splat", "/a/toy.v2.splat"),
        ("/a/toy.SPZ", "spz", "/a/toy.SPZ"),
    ],
)
def test_the_format_gives_the_name_its_suffix(path, kind, wanted):
    path, wanted = str(Path(path)), str(Path(wanted))
    dialog = SimpleNamespace(filepath=path, kind=kind)
    changed = part("operators.io.export_ply").SVRGS_OT_export_ply.check(dialog, None)
    assert dialog.filepath == wanted and changed == (path != wanted)
