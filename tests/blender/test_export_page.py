"""A web page of the active splat and its original, as the scene's camera sees it."""

from __future__ import annotations

import json
import re

import bpy
import numpy as np
import pytest
from extension import part


def export(folder, **words):
    return bpy.ops.svrgs.export_page(directory=str(folder), **words)


def page_of(folder) -> dict:
    text = (folder / "index.html").read_text(encoding="utf-8")
    return json.loads(
        re.search(r'<script type="application/json" id="page">(.*?)</script>', text, re.DOTALL)[1]
    )


@pytest.fixture(autouse=True)
def with_modules():
    page = part("svrgs_addon.viewer.web_page")
    if not all(page.packed_module(name).exists() for name in page.MODULES):
        pytest.skip("needs the modules of web pages: make wheels")


def test_the_page_shows_the_splat_as_it_stands_in_blender_from_the_scenes_camera(splat, bridge, tmp_path):
    data = bpy.data.cameras.new("looking")
    camera = bpy.data.objects.new("looking", data)
    bpy.context.collection.objects.link(camera)
    camera.location, camera.rotation_euler = (1, -5, 2), (1.2, 0, 0.3)
    bpy.context.scene.camera, splat.location = camera, (3, 0, 0)
    bpy.context.view_layer.update()
    assert export(tmp_path) == {"FINISHED"}
    folder = tmp_path / bpy.path.clean_name(splat.name)
    page = page_of(folder)
    np.testing.assert_allclose(page["start"]["position"], (1, -2, -5), atol=1e-5)  # y down, z ahead
    np.testing.assert_allclose(page["up"], (0, -1, 0))
    ahead = np.subtract(page["start"]["target"], page["start"]["position"])
    expected = camera.matrix_world.to_3x3() @ part("operators.data.splat_object").Matrix.Identity(3).col[2]
    np.testing.assert_allclose(
        ahead / np.linalg.norm(ahead), (-expected.x, expected.z, -expected.y), atol=1e-5
    )
    held = part("svrgs_addon.files.registry").read_scene(folder / "scene.spz")
    assert held.count == bridge.count(splat)
    own = np.array([splat.matrix_world @ vertex.co for vertex in points(splat)])
    np.testing.assert_allclose(np.sort(held.means[:, 0]), np.sort(own[:, 0]), atol=1e-3)
    np.testing.assert_allclose(np.sort(held.means[:, 1]), np.sort(-own[:, 2]), atol=1e-3)


def points(splat):
    """Points with a place `co`."""
    data = splat.data
    return data.vertices if hasattr(data, "vertices") else data.points


def test_the_original_comes_along_unless_it_is_not_wanted(splat, bridge, tmp_path):
    bpy.ops.object.duplicate()
    pruned = bpy.context.object
    part("operators.data.pairs").join(splat, pruned)
    part("operators.data.pairs").set_hidden(splat, True)
    assert export(tmp_path / "a") == {"FINISHED"}
    assert export(tmp_path / "b", with_original=False) == {"FINISHED"}
    name = bpy.path.clean_name(pruned.name)
    assert [one["name"] for one in page_of(tmp_path / "a" / name)["scenes"]] == [splat.name, pruned.name]
    assert [one["file"] for one in page_of(tmp_path / "b" / name)["scenes"]] == ["scene.spz"]


def test_another_page_is_left_as_it_is(splat, tmp_path):
    folder = tmp_path / bpy.path.clean_name(splat.name)
    folder.mkdir()
    (folder / "index.html").write_text("mine")
    with pytest.raises(RuntimeError, match="holds another page"):
        export(tmp_path)
    assert [path.name for path in folder.iterdir()] == ["index.html"]
