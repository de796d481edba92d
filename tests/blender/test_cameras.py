"""Cameras from COLMAP, held against Blender's own matrices, and Blender's cameras as the rasterizer needs
them."""

from __future__ import annotations

import shutil
import time
from pathlib import Path

import bpy
import numpy as np
import pytest
from bpy_extras.object_utils import world_to_camera_view
from extension import DATA, part
from job_helpers import drawn
from mathutils import Matrix, Vector

PX = 0.01


def seen_by_blender(obj, scene, points) -> np.ndarray:
    """(P, 2) pixels, from the top left, at which Blender's projection matrix shows world points; NaN behind
    the camera."""
    render = scene.render
    width, height = (
        side * render.resolution_percentage // 100 for side in (render.resolution_x, render.resolution_y)
    )
    projection = obj.calc_matrix_camera(
        bpy.context.evaluated_depsgraph_get(),
        x=width,
        y=height,
        scale_x=render.pixel_aspect_x,
        scale_y=render.pixel_aspect_y,
    )
    clip = np.array(
        [projection @ obj.matrix_world.normalized().inverted() @ Vector((*point, 1)) for point in points]
    )
    with np.errstate(invalid="ignore"):
        ndc = np.where(clip[:, 3:] > 0.01, clip[:, :2] / clip[:, 3:], np.nan)
    return np.column_stack([(ndc[:, 0] + 1) / 2 * width, (1 - ndc[:, 1]) / 2 * height])


def cameras() -> list:
    return sorted(
        (obj for obj in bpy.data.objects if obj.type == "CAMERA"), key=lambda obj: obj.data["svrgs_image"]
    )


def in_world(root, points) -> np.ndarray:
    return (
        points.astype(np.float64) @ np.array(root.matrix_world, np.float64)[:3, :3].T
        + np.array(root.matrix_world)[:3, 3]
    )


def activate(obj):
    bpy.context.scene.camera = obj
    bpy.context.view_layer.update()


def test_imported_cameras_see_what_the_photographs_saw(dataset):
    folder, views = dataset
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    (root,) = {obj.parent for obj in cameras()}
    scene, worst = bpy.context.scene, 0.0
    for view, obj in enumerate(cameras()):
        activate(obj)
        # the picture's size comes with its camera
        assert (scene.render.resolution_x, scene.render.resolution_y) == tuple(views.sizes[view])
        expected, world = views.pixels(view), in_world(root, views.points)
        found = seen_by_blender(obj, scene, world)
        both = np.isfinite(expected).all(1) & (np.abs(expected) < 4 * views.sizes[view].max()).all(1)
        assert both.sum() > 20
        worst = max(worst, np.abs(found - expected)[both].max())
        for k in np.flatnonzero(both)[:5]:
            x, y, _ = world_to_camera_view(scene, obj, Vector(world[k]))
            pixel = np.array([x, 1 - y]) * views.sizes[view]
            assert (
                np.abs(pixel - expected[k]).max() < PX
                or scene.render.pixel_aspect_x != scene.render.pixel_aspect_y
            )
    assert worst < PX
    assert [obj.data["svrgs_image"] for obj in cameras()] == views.names


def test_photographs_and_points_come_along(dataset):
    folder, views = dataset
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    for obj, name, size in zip(cameras(), views.names, views.sizes, strict=True):
        (background,) = obj.data.background_images
        assert Path(bpy.path.abspath(background.image.filepath)).samefile(folder / "images" / name)
        assert tuple(background.image.size) == tuple(size) and obj.data.show_background_images
    (points,) = (obj for obj in bpy.data.objects if obj.type == "MESH")
    stored = np.empty(3 * len(points.data.vertices), np.float32)
    points.data.vertices.foreach_get("co", stored)
    np.testing.assert_array_equal(np.sort(stored), np.sort(views.points.reshape(-1)))
    assert points.parent == cameras()[0].parent
    colour = np.array(points.data.attributes["Color"].data[0].color_srgb)
    np.testing.assert_allclose(colour, (200 / 255, 150 / 255, 100 / 255, 1), atol=1e-6)


def test_transforms_json_gives_the_same_cameras(capfd):
    found = []
    for name in ("tiny", "nerfstudio"):
        bpy.ops.svrgs.import_colmap(directory=str(DATA / name))
        bpy.context.view_layer.update()
        found.append(
            [obj for obj in cameras() if obj.name.partition(".png")[2] == ("" if name == "tiny" else ".001")]
        )
    assert len(found[0]) == len(found[1]) == 12
    for a, b in zip(*found, strict=True):
        np.testing.assert_allclose(a.matrix_world, b.matrix_world, atol=1e-6)
        files = [Path(bpy.path.abspath(obj.data.background_images[0].image.filepath)) for obj in (a, b)]
        assert files[0].read_bytes() == files[1].read_bytes()
    assert f"the cameras are those of {DATA / 'nerfstudio/transforms.json'}" in capfd.readouterr().out


def test_cameras_join_the_splat_wherever_it_stands():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    splat.location, splat.rotation_euler, splat.scale = (1, 2, 3), (0.1, 0.2, 0.3), (2, 2, 2)
    bpy.context.view_layer.update()
    before = np.array(splat.matrix_world)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    (root,) = {obj.parent for obj in cameras()}
    assert splat.parent == root and np.array(splat.matrix_basis).tolist() == np.eye(4).tolist()
    np.testing.assert_allclose(splat.matrix_world, before, atol=1e-6)
    bpy.context.view_layer.objects.active = cameras()[0]
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    bpy.context.view_layer.update()
    assert bpy.context.object.parent == root
    np.testing.assert_allclose(bpy.context.object.matrix_world, before, atol=1e-6)


def test_an_imported_camera_goes_back_as_it_was(dataset):
    folder, views = dataset
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    root = cameras()[0].parent
    root.matrix_world = Matrix.Translation((3, -1, 2)) @ Matrix.Rotation(1, 4, "Y") @ Matrix.Scale(2.5, 4)
    bpy.context.view_layer.update()
    for view, obj in enumerate(cameras()):
        camera = (
            part("operators.data.camera_object")
            .camera_from_object(obj, bpy.context.scene)
            .moved(root.matrix_world)
        )
        np.testing.assert_allclose(camera.viewmat, views.viewmats[view], atol=2e-5)
        np.testing.assert_allclose(camera.K, views.Ks[view], atol=PX / 10)
        assert (camera.width, camera.height, camera.name) == (*views.sizes[view], views.names[view])


@pytest.mark.parametrize("fit", ["AUTO", "HORIZONTAL", "VERTICAL"])
@pytest.mark.parametrize("size", [(640, 360, 100), (301, 500, 50)])
@pytest.mark.parametrize("aspect", [(1, 1), (1.5, 1), (1, 2)])
@pytest.mark.parametrize("kind", ["PERSP", "ORTHO"])
def test_any_camera_is_what_blender_makes_of_it(kind, fit, size, aspect):
    scene, rng = bpy.context.scene, np.random.default_rng(1)
    data = bpy.data.cameras.new("own")
    data.sensor_fit, data.lens, data.sensor_width, data.sensor_height = fit, 31, 30, 20
    data.shift_x, data.shift_y = 0.2, -0.15
    data.type, data.ortho_scale = kind, 7.3
    obj = bpy.data.objects.new("own", data)
    scene.collection.objects.link(obj)
    obj.location, obj.rotation_euler, obj.scale = (1, -2, 3), (0.5, 1, -2), (2, 2, 2)
    scene.render.resolution_x, scene.render.resolution_y, scene.render.resolution_percentage = size
    scene.render.pixel_aspect_x, scene.render.pixel_aspect_y = aspect
    try:
        bpy.context.view_layer.update()
        camera = part("operators.data.camera_object").camera_from_object(obj, scene)
        points = np.array(
            [
                obj.matrix_world.normalized() @ Vector((*xy, z))
                for *xy, z in rng.uniform((-3, -3, -9), (3, 3, -2), (40, 3))
            ]
        )
        found = camera.pixels(points @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3])
        assert np.abs(found - seen_by_blender(obj, scene, points)).max() < PX
        if size[2] == 100:  # Blender's helper does not round the size
            shares = np.array([world_to_camera_view(scene, obj, Vector(point)) for point in points])
            assert np.abs(found - np.column_stack([shares[:, 0], 1 - shares[:, 1]]) * size[:2]).max() < PX
        assert (camera.width, camera.height) == tuple(side * size[2] // 100 for side in size[:2])
    finally:
        scene.render.resolution_percentage = 100
        scene.render.pixel_aspect_x = scene.render.pixel_aspect_y = 1


def test_panoramas_are_refused():
    obj = bpy.data.objects.new("flat", bpy.data.cameras.new("flat"))
    obj.data.type = "PANO"
    with pytest.raises(Exception, match="'flat' is neither perspective nor orthographic"):
        part("operators.data.camera_object").camera_from_object(obj, bpy.context.scene)


class Nothing(bpy.types.RenderEngine):
    """Notes the size it is asked for."""

    bl_idname, bl_label = "TEST_NOTHING", "Nothing"
    asked = []

    def render(self, depsgraph):
        self.asked.append((self.resolution_x, self.resolution_y))
        self.end_result(self.begin_result(0, 0, self.resolution_x, self.resolution_y))


def test_a_render_takes_the_size_of_a_camera_that_became_active_just_before():
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "varied"))
    scene = bpy.context.scene
    activate(cameras()[0])
    engine, scene.camera = scene.render.engine, cameras()[-1]
    bpy.utils.register_class(Nothing)
    try:
        scene.render.engine = Nothing.bl_idname
        bpy.ops.render.render()
    finally:
        scene.render.engine = engine
        bpy.utils.unregister_class(Nothing)
    assert Nothing.asked == [tuple(cameras()[-1].data["svrgs_size"])]


def test_the_size_saved_with_a_file_is_kept_on_opening(tmp_path):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.scene.render.resolution_x = 32
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.context.view_layer.update()
    assert bpy.context.scene.render.resolution_x == 32
    activate(cameras()[3])
    assert bpy.context.scene.render.resolution_x == 64


def test_a_smaller_render_of_the_same_camera_stays_small():
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    scene = bpy.context.scene
    activate(cameras()[1])
    scene.render.resolution_x = 32
    bpy.context.view_layer.update()
    assert scene.render.resolution_x == 32


def test_photographs_of_a_distorting_lens_are_shown_as_their_pinholes_see_them(tmp_path):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "distorted"), undistorted=str(tmp_path))
    for obj in cameras():
        image = obj.data.background_images[0].image
        assert Path(bpy.path.abspath(image.filepath)).resolve().parent == tmp_path
        assert tuple(image.size) == tuple(obj.data["svrgs_size"])


def follow(work, seconds: float = 60):
    """Calls the timer's function, as Blender would, until it wants no more."""
    end = time.monotonic() + seconds
    while work.tick() is not None:
        assert time.monotonic() < end
        time.sleep(0.02)


def test_cameras_are_there_before_their_photographs_are_undistorted(tmp_path, monkeypatch, capfd):
    """In a window. One camera is deleted meanwhile."""
    work, undistort = part("operators.data.background_work"), part("operators.io.undistort")
    monkeypatch.setattr(work, "waits", False)
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "distorted"), undistorted=str(tmp_path))
    said = capfd.readouterr().out
    assert len(cameras()) == 2 and not any(obj.data.background_images for obj in cameras())
    assert (
        "Imported 2 cameras and 0 photographs; 2 photographs are being undistorted first; 120 sparse"
        " points, hidden" in said
    )
    assert "; the scene's camera is now '00.png', 60 x 44" in said
    assert undistort.status() in [f"Undistorting photographs: {done} of 2" for done in range(3)]
    bpy.data.objects.remove(cameras()[0])
    follow(work)
    (left,) = cameras()
    assert Path(bpy.path.abspath(left.data.background_images[0].image.filepath)).resolve().parent == tmp_path
    assert not part("operators.io.undistort").status()


def test_photographs_that_cannot_be_undistorted_are_missed_and_it_is_said(tmp_path, capfd):
    (tmp_path / "file").write_text("where a folder should be")
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "distorted"), undistorted=str(tmp_path / "file"))
    assert len(cameras()) == 2 and not any(obj.data.background_images for obj in cameras())
    sentence = "the photographs of lenses with distortion are not shown"
    assert sentence in capfd.readouterr().out and sentence in part("operators.io.undistort").status()
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "distorted"), undistorted=str(tmp_path / "folder"))
    assert not part("operators.io.undistort").status()


def test_cameras_come_without_photographs_and_say_so(tmp_path, capfd):
    shutil.copytree(DATA / "tiny/sparse", tmp_path / "sparse")
    bpy.ops.svrgs.import_colmap(directory=str(tmp_path))
    assert len(cameras()) == 12 and not any(obj.data.background_images for obj in cameras())
    out = capfd.readouterr().out
    assert "has no image folder images; give the name" in out
    assert "; the cameras were loaded without photographs" in out


def copy_of(name: str, folder: Path) -> Path:
    shutil.copytree(DATA / name, folder, symlinks=False)
    return folder


def test_missing_photographs_are_said_and_the_others_shown(tmp_path, capfd):
    folder = copy_of("tiny", tmp_path / "data")
    for name in ("01.png", "02.png"):
        (folder / "images" / name).unlink()
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    sentence = "2 of 12 photographs are missing: 01.png, 02.png; the other 10 are used"
    assert len(cameras()) == 10 and all(obj.data.background_images for obj in cameras())
    out = capfd.readouterr().out
    assert sentence in out and "Imported 10 cameras and 10 photographs" in out
    assert sentence in part("operators.io.undistort").status() and "photographs are missing" in drawn("scene")
    bpy.data.batch_remove([obj for obj in bpy.data.objects if obj.type == "EMPTY"])
    assert not part("operators.io.undistort").status(), "what was said is about cameras that are gone"
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert not part("operators.io.undistort").status(), "what was said is about the import before"


def test_one_damaged_photograph_does_not_hide_the_others(tmp_path):
    folder = copy_of("distorted", tmp_path / "data")
    data = (folder / "images/00.png").read_bytes()
    (folder / "images/00.png").write_bytes(data[: len(data) // 2])
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    assert [len(obj.data.background_images) for obj in cameras()] == [0, 1]
    assert "00.png: cannot be read as an image" in part("operators.io.undistort").status()


def test_each_photograph_finds_its_camera_if_others_vanish_meanwhile(tmp_path, monkeypatch):
    folder, undistort = copy_of("distorted", tmp_path / "data"), part("operators.io.undistort")
    start = undistort.start
    monkeypatch.setattr(
        undistort, "start", lambda *words: ((folder / "images/00.png").unlink(), start(*words))
    )
    bpy.ops.svrgs.import_colmap(directory=str(folder))
    first, second = cameras()
    assert not first.data.background_images
    assert Path(second.data.background_images[0].image.filepath).name == "01.png.png"


def test_a_folder_without_a_model_is_refused(tmp_path):
    with pytest.raises(RuntimeError, match="holds no COLMAP model"):
        bpy.ops.svrgs.import_colmap(directory=str(tmp_path))
    assert not bpy.data.objects


def test_a_copy_of_a_photographs_camera_is_no_photograph():
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    before, module = cameras(), part("operators.data.camera_object")
    copy = before[3].copy()
    copy.data = before[3].data.copy()
    bpy.context.scene.collection.objects.link(copy)
    assert copy.parent == before[3].parent
    found = module.photographs(bpy.data.objects)
    assert len(found) == 12 and copy not in found
    before[3].parent = copy.parent = None  # those of two captures may have the same names
    assert len(module.photographs(bpy.data.objects)) == 13


CHANGES = {  # what a user may make of sparse points
    "modifier": lambda obj: obj.modifiers.new("thin", "DECIMATE"),
    "moved point": lambda obj: setattr(obj.data.vertices[3], "co", (0, 0, 9)),
    "moved": lambda obj: setattr(obj, "location", (0, 0, 9)),
    "material": lambda obj: obj.data.materials.append(bpy.data.materials.new("mine")),
}


@pytest.mark.parametrize("change", CHANGES)
def test_importing_a_dataset_again_replaces_its_points_as_it_does_its_cameras(change):
    points = lambda: [obj for obj in bpy.data.objects if obj.type == "MESH"]
    for _ in range(2):
        bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
        assert len(cameras()) == 12 and len(points()) == 1
    CHANGES[change](points()[0])
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    assert len(cameras()) == 12 and len(points()) == 2, "what the user made of them stays"
