"""After an import the scene is level, the viewport shows it, and its sparse points are hidden."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from mathutils import Matrix, Quaternion, Vector


def tops() -> np.ndarray:
    """(V, 3) the upper sides of the photographs, in Blender's world."""
    bpy.context.view_layer.update()
    return np.array(
        [
            obj.matrix_world.to_3x3().normalized() @ Vector((0, 1, 0))
            for obj in bpy.data.objects
            if obj.type == "CAMERA"
        ]
    )


def root() -> bpy.types.Object:
    return next(obj for obj in bpy.data.objects if obj.type == "EMPTY")


@pytest.fixture
def views() -> list[tuple]:
    """(space, view) of every viewport, as a user finds them."""
    found = [
        (area.spaces.active, area.spaces.active.region_3d)
        for area in bpy.context.screen.areas
        if area.type == "VIEW_3D"
    ]
    assert found
    for space, view in found:
        view.view_location, view.view_distance, view.view_perspective = (7, 8, 9), 123, "PERSP"
        view.view_rotation = Quaternion((0.8, 0.6, 0, 0))
        space.clip_start, space.clip_end = 0.01, 1000
    return found


@pytest.mark.parametrize("turned", [False, True])
def test_cameras_are_level_whatever_axis_is_up_in_the_file(capfd, turned):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / ("z_up" if turned else "tiny")))
    assert tops().mean(axis=0)[2] > 0.95 and np.abs(tops().mean(axis=0)[:2]).max() < 0.1
    assert ("levelled, by a turn of 90°" in capfd.readouterr().out) == turned


def test_the_splat_turns_with_the_cameras_and_keeps_its_numbers(bridge):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    before = bridge.scene_from_object(splat).means.tobytes()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "z_up"))
    bpy.context.view_layer.update()
    assert splat.parent == root() and tops().mean(axis=0)[2] > 0.95
    np.testing.assert_allclose(splat.matrix_world, root().matrix_world, atol=1e-7)
    assert bridge.scene_from_object(splat).means.tobytes() == before


def test_levelling_can_be_left_out(bridge):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "z_up"), level=False)
    np.testing.assert_allclose(root().matrix_world, bridge.AXES, atol=1e-6)
    assert tops().mean(axis=0)[1] > 0.95


@pytest.mark.parametrize(
    "matrix", [Matrix.Rotation(0.1, 4, "X"), Matrix.Translation((1, 0, 0)), Matrix.Scale(2, 4)]
)
def test_a_dataset_that_was_moved_stays_where_it_is(matrix):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    splat.matrix_world = matrix @ splat.matrix_world
    bpy.context.view_layer.update()
    before = splat.matrix_world.copy()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "z_up"))
    bpy.context.view_layer.update()
    np.testing.assert_allclose(splat.matrix_world, before, atol=1e-6)


def test_photographs_that_do_not_agree_are_not_levelled(capfd, bridge):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "rolled"))
    assert "not levelled, because the photographs do not agree on what is up" in capfd.readouterr().out
    np.testing.assert_allclose(root().matrix_world, bridge.AXES, atol=1e-6)


def test_sparse_points_are_hidden_at_first():
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    (points,) = (obj for obj in bpy.data.objects if obj.type == "MESH")
    assert points.hide_get() and not points.hide_viewport, "the eye shows them"
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"), points=False)
    assert [obj for obj in bpy.data.objects if obj.type == "MESH"] == [points]


def floaters(bridge, make_scene):
    """A splat of 500 Gaussians around the origin, of which 5 are 1e5 away."""
    scene = make_scene(further=False)
    scene.means[:5] *= 1e5
    scene.opacity_logits[:] = 1
    return bridge.object_from_scene("splat", scene, bpy.context.collection)


def test_frame_shows_the_mass_of_the_splat_and_not_its_floaters(bridge, make_scene, views):
    obj = floaters(bridge, make_scene)
    obj.location, obj.scale = (10, 20, 30), (0.5, 0.5, 0.5)
    bpy.context.view_layer.objects.active = obj
    bpy.ops.svrgs.frame()
    for space, view in views:
        assert (view.view_location - Vector((10, 20, 30))).length < 0.3 and 3 < view.view_distance < 10
        assert (space.clip_start, space.clip_end) == (
            pytest.approx(0.01),
            1000,
        ) and view.view_rotation.angle > 1, "what fits is left alone"


def test_an_imported_splat_is_framed(views, ply, make_scene, tmp_path):
    scene = make_scene(further=False)
    scene.means[:] *= 1000
    ply.write_ply(tmp_path / "large.ply", scene)
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "large.ply"))
    for space, view in views:
        assert view.view_location.length < 500 and 2000 < view.view_distance < 20_000
        assert space.clip_end == pytest.approx(100 * view.view_distance)
    for _, view in views:
        view.view_distance = 123
    bpy.ops.svrgs.import_ply(filepath=str(tmp_path / "large.ply"), frame=False)
    assert all(view.view_distance == 123 for _, view in views)


def eye(view) -> Vector:
    return view.view_location + view.view_rotation @ Vector((0, 0, view.view_distance))


def test_a_dataset_is_seen_from_its_first_camera_with_the_horizon_level(views):
    """A sky around the splat does not matter then: the camera is inside it."""
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    for _, view in views:
        camera = bpy.context.scene.camera.matrix_world.translation
        # a little nearer, so that the camera is not in the picture
        assert (eye(view) - camera.lerp(view.view_location, 0.2)).length < 1e-4
        assert view.view_location.length < 1, "the middle of the ring of cameras, which are 3 away"
        assert abs((view.view_rotation @ Vector((1, 0, 0))).z) < 1e-6


def test_cameras_without_a_splat_are_all_in_the_picture(views):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    for space, view in views:
        assert view.view_location.length < 1
        assert view.view_rotation.angle == pytest.approx(Quaternion((0.8, 0.6, 0, 0)).angle)
        assert view.view_distance > 3 * space.lens / 36, "of which each is 3 away from the middle"


def test_a_parallel_view_keeps_its_direction(views):
    for _, view in views:
        view.view_perspective = "ORTHO"
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    for _, view in views:
        assert view.view_perspective == "ORTHO"
        assert view.view_rotation.angle == pytest.approx(Quaternion((0.8, 0.6, 0, 0)).angle)
        assert view.view_location.length < 1 and view.view_distance < 30


def test_a_view_through_a_camera_is_left_alone(views):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    for _, view in views:
        view.view_perspective, view.view_distance = "CAMERA", 123
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert all(view.view_perspective == "CAMERA" and view.view_distance == 123 for _, view in views)
    bpy.ops.svrgs.frame()
    # asked for by the user
    assert all(view.view_perspective == "PERSP" and view.view_distance < 30 for _, view in views)


def test_frame_says_what_it_needs():
    assert not bpy.ops.svrgs.frame.poll()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert bpy.ops.svrgs.frame.poll() and part("operators.data.splat_object").root_of(bpy.context.object)
