"""A splat, and the cameras that it is joined to."""

from __future__ import annotations

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import drawn
from mathutils import Euler, Matrix


@pytest.fixture
def match():
    yield part("operators.scene.camera_match")
    part("operators.data.known").objects.clear()


def other_splat(make_scene, bridge):
    """A splat of no capture, active."""
    obj = bridge.object_from_scene("other", make_scene(further=False), bpy.context.collection)
    activate(obj)
    return obj


def activate(*objects):
    bpy.ops.object.select_all(action="DESELECT")
    for obj in objects:
        obj.select_set(True)
        bpy.context.view_layer.objects.active = obj


def root() -> bpy.types.Object:
    return next(obj for obj in bpy.data.objects if obj.type == "EMPTY")


def checked(match) -> str:
    match.check()
    return match.sentence(bpy.context)


def test_the_panel_says_that_cameras_are_of_another_capture(splat, match, make_scene, bridge):
    bpy.context.scene.svrgs_prune.data = ""
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert checked(match) == "" and "another capture" not in drawn("prune")
    other = other_splat(make_scene, bridge)
    bpy.ops.svrgs.use_cameras(root=root().name)
    assert bridge.root_of(other) == root() and "another capture" in checked(match)
    assert "another capture" in drawn("prune")
    activate(splat)
    assert "another capture" not in drawn("prune")


def test_splats_are_joined_and_parted_by_hand(splat, bridge):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    second = bpy.context.object
    activate(splat)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert bridge.root_of(splat) == root() and bridge.root_of(second) is None
    activate(second)
    assert f"Use Cameras of '{root().name}'" in drawn("scene")
    bpy.ops.svrgs.use_cameras(root=root().name)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(second.matrix_world, splat.matrix_world, atol=1e-6)
    assert "12 cameras of" in drawn("scene")
    bpy.ops.svrgs.part_from_cameras()
    bpy.context.view_layer.update()
    assert bridge.root_of(second) is None
    np.testing.assert_allclose(second.matrix_world, bridge.AXES, atol=1e-6)


def test_what_the_user_has_moved_stays_moved(splat, bridge):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    second = bpy.context.object
    activate(splat)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    moved = Matrix.LocRotScale((1, 2, 3), Euler((0.1, 0.2, 0.3)), (2, 2, 2))
    second.matrix_world = bridge.AXES @ moved
    bpy.context.view_layer.update()
    activate(second)
    bpy.ops.svrgs.use_cameras(root=root().name)
    bpy.context.view_layer.update()
    np.testing.assert_allclose(bridge.to_file(second, second.matrix_world), moved, atol=1e-5)
    bpy.ops.svrgs.part_from_cameras()
    bpy.context.view_layer.update()
    np.testing.assert_allclose(second.matrix_world, bridge.AXES @ moved, atol=1e-5)


def test_cameras_of_another_dataset_get_a_root_of_their_own(splat, bridge):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    activate(splat)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "varied"))
    roots = [obj for obj in bpy.data.objects if obj.type == "EMPTY"]
    assert len(roots) == 2 and bridge.root_of(splat)[bridge.DATASET].endswith("tiny")
    assert sorted(sum(child.type == "CAMERA" for child in empty.children) for empty in roots) == [5, 12]


def test_the_check_runs_beside_blender(splat, match, monkeypatch):
    """As with a window: a timer starts a thread."""
    work, known = part("operators.data.background_work"), part("operators.data.known").of(splat)
    monkeypatch.setattr(work, "waits", False)
    monkeypatch.setattr(match, "_mismatch", lambda *_: "of another capture")
    bpy.context.scene.svrgs_prune.data = str(DATA / "tiny")
    assert match.sentence(bpy.context) == "" and not known.cameras_checked[0]
    while work.tick() is not None:
        assert match.sentence(bpy.context) in ("", "of another capture")
    assert match.sentence(bpy.context) == "of another capture"
