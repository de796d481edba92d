"""A USD stage that Blender exports keeps its splats: as prims of their kind, where the objects are, also as
instances."""

from __future__ import annotations

import sys
from pathlib import Path

import bpy
import numpy as np
import pytest
from extension import part


@pytest.fixture
def formats():
    return part("svrgs_addon.files.registry")


@pytest.fixture(autouse=True)
def own_pxr(monkeypatch):
    """Blender's own OpenUSD comes first, as in Blender itself; other tests may have loaded that of PyPI."""
    if sys.platform == "win32":  # the Python there has no other
        yield
        return
    lib = Path(bpy.utils.resource_path("LOCAL"), "python", "lib")
    folder = lib / f"python3.{sys.version_info.minor}" / "site-packages"
    if not (folder / "pxr").is_dir():
        pytest.skip("this Blender has no OpenUSD")
    kept = {name: module for name, module in sys.modules.items() if name.partition(".")[0] == "pxr"}
    for name in kept:
        del sys.modules[name]
    monkeypatch.syspath_prepend(str(folder))
    monkeypatch.setenv("PYTHONPATH", str(folder))  # of the child process that reads a stage
    yield
    for name in [name for name in sys.modules if name.partition(".")[0] == "pxr"]:
        del sys.modules[name]
    sys.modules.update(kept)


def export(path, **words):
    return bpy.ops.wm.usd_export(filepath=str(path), **words)


def moved(scene, matrix):
    """The scene in Blender's world, as the file has it: y down."""
    objects = part("operators.data.splat_object")
    return part("svrgs_addon.scene.affine").transformed(scene, objects.relative(objects.AXES, matrix))


def same(found, expected):
    assert found.count == expected.count and found.sh_degree == expected.sh_degree
    for name in ("means", "log_scales", "opacity_logits", "sh"):
        assert np.allclose(getattr(found, name), getattr(expected, name), atol=2e-3), name


@pytest.mark.parametrize("up", [False, True])
def test_an_exported_stage_holds_the_splat_where_it_is(up, splat, formats, bridge, tmp_path):
    splat.location, splat.rotation_euler, splat.scale = (1, 2, 3), (0.4, 0.5, 0.6), (2, 2, 2)
    bpy.context.view_layer.update()
    words = (
        {
            "convert_orientation": True,
            "export_global_forward_selection": "NEGATIVE_Z",
            "export_global_up_selection": "Y",
        }
        if up
        else {}
    )
    assert export(tmp_path / "stage.usdc", **words) == {"FINISHED"}
    same(
        formats.read_scene(tmp_path / "stage.usdc"),
        moved(bridge.scene_from_object(splat), splat.matrix_world),
    )


@pytest.mark.parametrize("instances", [False, True])
def test_instances_and_copies_are_splats_too(instances, splat, formats, bridge, tmp_path):
    collection = bpy.data.collections.new("town")
    collection.objects.link(splat)
    empty = bpy.data.objects.new("there", None)
    empty.instance_type, empty.instance_collection, empty.location = "COLLECTION", collection, (5, 0, 0)
    bpy.context.scene.collection.objects.link(empty)
    bpy.context.view_layer.update()
    assert export(tmp_path / "stage.usda", use_instancing=instances) == {"FINISHED"}
    found = formats.read_scene(tmp_path / "stage.usda")
    assert found.count == 2 * bridge.count(splat)
    assert np.ptp(found.means[:, 0]) == pytest.approx(
        5 + np.ptp(moved(bridge.scene_from_object(splat), splat.matrix_world).means[:, 0]), abs=1e-3
    )


def test_gaussians_hidden_as_removed_are_not_in_the_stage(splat, formats, bridge, tmp_path):
    removed = np.zeros(bridge.count(splat), bool)
    removed[:3] = True
    bridge.set_values(splat, part("operators.data.visible_splats").REMOVED, "BOOLEAN", removed)
    assert export(tmp_path / "stage.usdc") == {"FINISHED"}
    assert formats.read_scene(tmp_path / "stage.usdc").count == bridge.count(splat) - 3


def test_a_stage_without_splats_is_as_blender_writes_it(tmp_path, formats):
    mesh = bpy.data.meshes.new("points")
    mesh.from_pydata([(0, 0, 0), (1, 1, 1)], [], [])
    bpy.context.collection.objects.link(bpy.data.objects.new("points", mesh))
    assert export(tmp_path / "stage.usda") == {"FINISHED"}
    assert "def Mesh" in (tmp_path / "stage.usda").read_text()


def test_without_names_of_objects_the_user_is_told(splat, tmp_path):
    if bpy.app.version >= (5, 2, 0):
        pytest.skip("this Blender knows the prims of its objects")
    with pytest.raises(RuntimeError, match="USD hook"):
        export(tmp_path / "stage.usda", export_custom_properties=False)
