"""Splat files and Blender's objects: nothing is lost on the way in and out."""

from __future__ import annotations

from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import Layout, drawn


@pytest.fixture
def splat(make_scene, ply, tmp_path):
    """(object, scene, file) of an imported splat."""
    ply.write_ply(tmp_path / "in.ply", make_scene())
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "in.ply"))
    return bpy.context.object, ply.read_ply(tmp_path / "in.ply"), tmp_path / "in.ply"


def exported(tmp_path, **options):
    bpy.ops.svrgs.export_ply(filepath=str(tmp_path / "out.ply"), **options)
    return tmp_path / "out.ply"


def values(obj, name: str, width: int) -> np.ndarray:
    attribute = obj.data.attributes[name]
    array = np.empty((len(attribute.data), width), np.float32)
    attribute.data.foreach_get(
        {"FLOAT_COLOR": "color", "QUATERNION": "value"}.get(attribute.data_type, "vector"), array.reshape(-1)
    )
    return array


def assert_same(a, b):
    for name in ("means", "log_scales", "quats", "opacity_logits", "sh"):
        assert getattr(a, name).tobytes() == getattr(b, name).tobytes(), name
    assert {name: column.tobytes() for name, column in a.attributes.items()} == {
        name: column.tobytes() for name, column in b.attributes.items()
    }


def test_attributes_are_those_of_blenders_own_splats(splat):
    obj, scene, _ = splat
    assert obj.type == ("POINTCLOUD" if bpy.app.version >= (4, 5) else "MESH")
    np.testing.assert_array_equal(values(obj, "position", 3), scene.means)
    np.testing.assert_allclose(
        values(obj, "scale", 3), np.exp(scene.log_scales.astype(np.float64)), rtol=1e-6
    )
    quats = scene.quats.astype(np.float64)
    np.testing.assert_allclose(
        values(obj, "rotation", 4), quats / np.linalg.norm(quats, axis=1, keepdims=True), atol=1e-6
    )
    base = values(obj, "radiance:base", 4)
    np.testing.assert_array_equal(base[:, :3], scene.sh[:, 0])
    np.testing.assert_allclose(
        base[:, 3], 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64))), atol=1e-6
    )
    for k in range(15):
        np.testing.assert_array_equal(values(obj, f"radiance:sh_{k}", 3), scene.sh[:, k + 1])
    assert obj.type == "MESH" or not {name for name in obj.data.attributes.keys() if name.startswith(".sel")}


def test_y_down_becomes_z_up(splat):
    obj, scene, _ = splat
    x, y, z = scene.means[0]
    np.testing.assert_allclose(
        obj.matrix_world @ obj.data.attributes["position"].data[0].vector, (x, z, -y), atol=1e-6
    )


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("further", [False, True])
def test_a_file_comes_out_as_it_went_in(make_scene, ply, tmp_path, degree, further):
    ply.write_ply(tmp_path / "in.ply", make_scene(degree=degree, further=further))
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "in.ply"))
    content = (tmp_path / "in.ply").read_bytes()
    assert exported(tmp_path).read_bytes() == content
    bpy.context.object.rotation_euler = (1, 2, 3)
    assert exported(tmp_path, space="LOCAL").read_bytes() == content
    assert exported(tmp_path).read_bytes() != content


def test_a_saved_and_copied_splat_keeps_every_bit(splat, tmp_path):
    obj, _, file = splat
    name, content = obj.name, file.read_bytes()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    copy = bpy.data.objects[name].copy()
    copy.data = copy.data.copy()
    bpy.context.collection.objects.link(copy)
    bpy.context.view_layer.objects.active = copy
    assert exported(tmp_path).read_bytes() == content


def test_points_deleted_in_edit_mode_are_gaussians_deleted(splat, ply, tmp_path):
    obj, scene, _ = splat
    gone = np.random.default_rng(0).random(scene.count) < 0.4
    if obj.type == "MESH":
        obj.data.vertices.foreach_set("select", gone)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.mesh.delete(type="VERT")
    else:
        obj.data.attributes.new(".selection", "BOOLEAN", "POINT").data.foreach_set("value", gone)
        bpy.ops.object.mode_set(mode="EDIT")
        bpy.ops.pointcloud.delete()
    inside = ply.read_ply(exported(tmp_path))  # while still in Edit Mode
    bpy.ops.object.mode_set(mode="OBJECT")
    for found in (inside, ply.read_ply(exported(tmp_path))):
        assert_same(found, scene.select(~gone))


def test_edited_attributes_win_over_the_files_numbers(splat, bridge):
    obj, scene, _ = splat
    scales = values(obj, "scale", 3)
    scales[::2] *= 2
    obj.data.attributes["scale"].data.foreach_set("vector", scales.reshape(-1))
    found = bridge.scene_from_object(obj)
    np.testing.assert_allclose(found.log_scales[::2], scene.log_scales[::2] + np.log(2), atol=2e-6)
    assert found.log_scales[1::2].tobytes() == scene.log_scales[1::2].tobytes()


def test_a_splat_of_blenders_own_import_is_exported(splat, ply, tmp_path):
    """As Blender 5.3 makes them: its attributes and no others of ours, a band above degree 3, a further
    column."""
    obj, scene, _ = splat
    del obj.data["svrgs"]
    for name in [a.name for a in obj.data.attributes if a.name.startswith(("svrgs:", "ply:"))]:
        obj.data.attributes.remove(obj.data.attributes[name])
    for k in range(15, 24):
        obj.data.attributes.new(f"radiance:sh_{k}", "FLOAT_VECTOR", "POINT")
    found = ply.read_ply(exported(tmp_path))
    np.testing.assert_array_equal(found.means, scene.means)
    np.testing.assert_array_equal(found.sh, scene.sh)
    np.testing.assert_allclose(found.log_scales, scene.log_scales, atol=1e-6)
    moderate = np.abs(scene.opacity_logits) < 10
    np.testing.assert_allclose(found.opacity_logits[moderate], scene.opacity_logits[moderate], atol=4e-3)
    np.testing.assert_array_equal(found.attributes["nx"], scene.attributes["nx"])


def test_world_coordinates_are_the_objects_transform(splat, ply, tmp_path, capfd):
    obj, scene, _ = splat
    obj.location, obj.rotation_euler, obj.scale = (1, 2, 3), (0.3, -2, 1), (2, 2, 2)
    bpy.context.view_layer.update()
    found = ply.read_ply(exported(tmp_path, space="WORLD", y_down=False))
    expected = part("svrgs_addon.scene.affine").transformed(scene, np.array(obj.matrix_world))
    assert_same(found, ply.read_ply(write(ply, tmp_path, expected)))
    assert "scaled differently" not in capfd.readouterr().out


def write(ply, tmp_path, scene):
    ply.write_ply(tmp_path / "expected.ply", scene)
    return tmp_path / "expected.ply"


def test_a_world_export_comes_back_where_it_was(splat, tmp_path):
    obj, _, _ = splat
    obj.rotation_euler = (0.3, -2, 1)
    bpy.context.view_layer.update()
    bpy.ops.svrgs.import_ply(filepath=str(exported(tmp_path, space="WORLD")))
    again = bpy.context.object
    places = [np.array(o.matrix_world)[:3, :3] @ values(o, "position", 3).T for o in (obj, again)]
    np.testing.assert_allclose(*places, atol=1e-5)


def test_unequal_scales_are_warned_about(splat, tmp_path, capfd):
    splat[0].scale = (1, 2, 1)
    bpy.context.view_layer.update()
    exported(tmp_path, space="WORLD")
    assert "scaled differently along its axes" in capfd.readouterr().out
    splat[0].scale = (1, 0, 1)
    bpy.context.view_layer.update()
    with pytest.raises(RuntimeError, match="scale of the object is zero"):
        exported(tmp_path, space="WORLD")


def test_several_files_at_once_and_one_that_is_none(make_scene, ply, tmp_path, capfd):
    for name in ("a", "b"):
        ply.write_ply(tmp_path / f"{name}.ply", make_scene(100))
    (tmp_path / "bad.ply").write_bytes(
        b"ply\nformat ascii 1.0\nelement vertex 1\nproperty float x\nend_header\n0\n"
    )
    bpy.ops.svrgs.import_ply(
        directory=str(tmp_path), files=[{"name": name} for name in ("a.ply", "bad.ply", "b.ply")]
    )
    assert {obj.name for obj in bpy.context.selected_objects} == {"a", "b"}
    said = capfd.readouterr().out
    assert "a.ply: 100 Gaussians; b.ply: 100 Gaussians" in said and "so it is not a 3DGS splat" in said
    with pytest.raises(RuntimeError, match="lacks the property"):
        bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "bad.ply"))


def test_the_panel_says_that_the_default_cube_hides_a_part():
    bpy.data.batch_remove(list(bpy.data.objects))
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object

    def said() -> bool:
        bpy.context.view_layer.update()
        layout = Layout()
        part("panels.scene").SVRGS_PT_scene.draw(SimpleNamespace(layout=layout), bpy.context)
        return "default cube may hide" in layout.text

    assert said()
    splat.location.x = 9
    assert not said(), "the splat is elsewhere"
    splat.location.x = 0
    cube.location.z = 9
    assert not said(), "the cube is elsewhere"
    cube.location.z = 0
    assert said()
    cube.hide_set(True)
    assert not said()


def test_importing_leaves_nothing_else_behind(splat):
    assert len(bpy.data.scenes) == 1 and len(bpy.data.objects) == 1
    assert len(bpy.data.meshes) + len(bpy.data.pointclouds) == 1


def test_export_says_what_is_missing(tmp_path):
    with pytest.raises(RuntimeError, match="Select a Gaussian splat first"):
        exported(tmp_path)


def test_hidden_splats_and_points_stay_whole(splat, tmp_path):
    obj, _, file = splat
    obj.hide_viewport = obj.hide_render = True
    obj.hide_set(True)
    if obj.type == "MESH":
        obj.data.vertices.foreach_set("hide", np.ones(len(obj.data.vertices), bool))
    assert exported(tmp_path).read_bytes() == file.read_bytes()


def test_joined_splats_are_exported_together(make_scene, ply, tmp_path):
    """Ctrl-J fills what one of them lacks with zeros."""
    a, b = make_scene(100, degree=1, further=False), make_scene(50, degree=3, further=False)
    for name, scene in (("a", a), ("b", b)):
        ply.write_ply(tmp_path / f"{name}.ply", scene)
    bpy.ops.svrgs.import_ply(directory=str(tmp_path), files=[{"name": "a.ply"}, {"name": "b.ply"}])
    bpy.ops.object.join()
    found = ply.read_ply(exported(tmp_path))
    order = np.argsort(found.means[:, 0])
    expected = np.concatenate([a.means, b.means])[np.argsort(np.concatenate([a.means, b.means])[:, 0])]
    assert found.sh.shape == (150, 16, 3)
    np.testing.assert_array_equal(found.means[order][:, 0], expected[:, 0])


@pytest.mark.parametrize("count", [0, 1])
def test_the_smallest_files_survive(make_scene, ply, tmp_path, count):
    ply.write_ply(tmp_path / "in.ply", make_scene(10).select(slice(0, count)))
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "in.ply"))
    assert exported(tmp_path).read_bytes() == (tmp_path / "in.ply").read_bytes()


def test_importing_while_another_object_is_in_edit_mode_leaves_it_there(make_scene, ply, tmp_path, bridge):
    bpy.ops.mesh.primitive_cube_add()
    cube = bpy.context.object
    bpy.ops.object.mode_set(mode="EDIT")
    ply.write_ply(tmp_path / "in.ply", make_scene(10))
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "in.ply"))
    assert bpy.context.object == cube and cube.mode == "EDIT"
    bpy.ops.object.mode_set(mode="OBJECT")
    assert bridge.is_splat(bpy.data.objects["in"]) and not bridge.is_splat(cube)


def test_a_mesh_is_no_splat(tmp_path):
    bpy.ops.mesh.primitive_cube_add()
    bpy.ops.wm.ply_export(filepath=str(tmp_path / "mesh.ply"))
    with pytest.raises(RuntimeError, match="so it is not a 3DGS splat"):
        bpy.ops.svrgs.import_ply(
            filepath=str(tmp_path / "mesh.ply"), directory=str(tmp_path), files=[{"name": "mesh.ply"}]
        )
    assert len(bpy.data.objects) == 1


def test_other_gaussians_leave_the_splat_its_materials_and_properties(splat, bridge):
    obj, scene, _ = splat
    name, material = obj.data.name, bpy.data.materials.new("own")
    obj.data.materials.append(material)
    obj.data["note"], obj.data["place"] = "mine", (1.0, 2.0, 3.0)
    bridge.replace_gaussians(obj, scene.select(slice(0, 100)))
    assert bridge.count(obj) == 100 and obj.data.name == name and obj.data.users == 1
    assert [slot.material for slot in obj.material_slots] == [material]
    assert obj.data["note"] == "mine" and tuple(obj.data["place"]) == (1.0, 2.0, 3.0)
    # what was replaced is gone, and nothing else was left
    assert len(bpy.data.pointclouds) + len(bpy.data.meshes) == 1 == len(bpy.data.objects)
    assert_same(bridge.scene_from_object(obj), scene.select(slice(0, 100)))


def test_an_object_that_shares_the_data_keeps_the_former_gaussians(splat, bridge):
    obj, scene, _ = splat
    other = obj.copy()
    bpy.context.collection.objects.link(other)
    bridge.replace_gaussians(obj, scene.select(slice(0, 100)))
    assert set(bpy.data.objects) == {obj, other} and obj.data != other.data
    assert bridge.count(obj) == 100
    assert_same(bridge.scene_from_object(other), scene)


def test_a_splat_that_is_a_mesh_stays_one(splat, bridge):
    """Blender 4.2 makes such; later ones open its files."""
    _, scene, _ = splat
    obj = bpy.data.objects.new("mesh", bridge._mesh("mesh", scene))
    bridge.replace_gaussians(obj, scene.select(slice(0, 100)))
    assert obj.type == "MESH"
    assert_same(bridge.scene_from_object(obj), scene.select(slice(0, 100)))


@pytest.mark.parametrize("degree", range(4))
def test_the_panel_says_what_an_export_would_hold(make_scene, bridge, degree):
    obj = bridge.object_from_scene("some", make_scene(1234, degree), bpy.context.scene.collection)
    bpy.context.view_layer.objects.active = obj
    about = part("operators.data.splat_size").about
    assert about(obj) == f"1,234 Gaussians, SH degree {degree}"
    if degree:
        obj.data.attributes.remove(obj.data.attributes["radiance:sh_1"])  # of the first band
        assert bridge.scene_from_object(obj).sh.shape[1] == 1 and about(obj).endswith("SH degree 0")
    obj.data.attributes.remove(obj.data.attributes["rotation"])
    assert not bridge.is_splat(obj)


def test_a_scene_without_a_splat_says_what_to_do_and_offers_a_sample(bridge):
    assert "Import a splat, or open the sample" in drawn("scene") and "Open Sample" in drawn("scene")
    sample = part("operators.io.import_ply").SAMPLE
    assert sample.stat().st_size < 300_000
    bpy.ops.svrgs.import_ply(filepath=str(sample))
    assert bridge.count(bpy.context.object) > 10_000 and bridge.sh_degree(bpy.context.object) == 1
    assert "Open Sample" not in drawn("scene")
    bpy.context.view_layer.objects.active = None
    assert "Open Sample" not in drawn("scene"), "there is a splat"
