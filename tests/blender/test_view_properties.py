"""Settings of a view: what they offer, and that they and their pictures survive a file."""

from __future__ import annotations

import typing

import bpy
import numpy as np
import pytest
from extension import part
from view_helpers import mark_removed, pixels

pytestmark = pytest.mark.usefixtures("stage")


def test_only_splats_are_offered_for_comparing(stage, room, camera):
    kinds = typing.get_type_hints(type(stage.svrgs_view))  # as Blender reads them
    for name in ("original", "pruned"):
        offered = kinds[name].keywords["poll"]
        assert offered(stage.svrgs_view, room) and not offered(stage.svrgs_view, camera)


def test_settings_and_images_survive_a_file(tmp_path, stage, room, camera):
    stage.svrgs_view.wipe = 0.25
    bpy.ops.svrgs.spatial_mask()
    bpy.data.images["SVR-GS Spatial Mask"].pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    assert bpy.context.scene.svrgs_view.wipe == 0.25 and bpy.context.scene.render.engine == "SVRGS"
    assert tuple(bpy.data.images["SVR-GS Spatial Mask"].size)[0] > 0
    bpy.ops.svrgs.spatial_mask()


@pytest.mark.parametrize("packed", [False, True])
def test_figures_of_pictures_are_saved_with_them(tmp_path, bridge, room, camera, packed):
    """packed: the user has packed the images, too."""
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    bpy.ops.svrgs.compare()
    bpy.ops.svrgs.spatial_mask()
    if packed:
        for image in bpy.data.images:
            image.pack()
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    assert part("operators.view.compare").figures() and part("operators.view.spatial_mask").figures()
    assert pixels(bpy.data.images["SVR-GS Wipe"])[..., :3].any()


def test_figures_go_with_pictures_that_were_deleted(tmp_path, bridge, room, camera):
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    bpy.ops.svrgs.compare()
    bpy.ops.svrgs.spatial_mask()
    for image in list(bpy.data.images):
        bpy.data.images.remove(image)
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))
    assert not part("operators.view.compare").figures() and not part("operators.view.spatial_mask").figures()


def test_no_shader_outlives_the_extension():
    """Blender's GPU ends before Python does."""
    module = part("operators.view.overlay")
    module._overlay._shader = object()
    module.unregister()
    assert module._overlay._shader is None
