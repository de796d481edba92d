"""The zip without pycolmap, in a Blender whose Python has no pycolmap: all but COLMAP models works.
../test_extension.py runs this by name."""

from __future__ import annotations

import importlib.util

import bpy
import numpy as np
import pytest
from extension import DATA
from view_helpers import LEVEL, f12, pixels

SHORT = {"iterations": 10, "recovery": 5, "target": 0.5, "seed": 3}


@pytest.fixture
def room():
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    return bpy.context.object


def test_there_is_no_pycolmap():
    assert importlib.util.find_spec("pycolmap") is None


def test_a_splat_is_imported_with_cameras_of_transforms_json_pruned_and_rendered(room, bridge, tmp_path):
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "nerfstudio"))
    scene = bpy.context.scene
    scene.render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    expected = pixels(bpy.data.images.load(str(DATA / f"renders/{scene.camera.name[:-4]}.rgb.png")))
    assert np.abs(f12(tmp_path / "original.png")[..., :3] - expected[..., :3]).max() <= LEVEL
    bpy.ops.svrgs.prune(out=str(tmp_path / "pruned.ply"), report_folder=str(tmp_path / "report"), **SHORT)
    pruned = bpy.context.object
    assert pruned != room and bridge.count(pruned) == 125 and (tmp_path / "pruned.ply").exists()
    assert (tmp_path / "report/index.html").exists()
    assert f12(tmp_path / "pruned.png").std() > 0.01


def test_a_colmap_model_is_refused_with_what_to_do(room, tmp_path):
    with pytest.raises(
        RuntimeError,
        match=(
            r"pycolmap.*use a Blender with a Python for which there is a zip with packages, or run .* -m pip"
            r" install pycolmap"
        ),
    ):
        bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    with pytest.raises(RuntimeError, match="pip install pycolmap"):
        bpy.ops.svrgs.prune(data=str(DATA / "tiny"), out=str(tmp_path / "pruned.ply"), **SHORT)
    assert not (tmp_path / "pruned.ply").exists()
