"""The spatial mask and the images of a comparison are in the saved file as they were seen."""

from __future__ import annotations

import bpy
import numpy as np
from extension import part
from view_helpers import mark_removed, pixels

NAMES = [f"SVR-GS {name}" for name in ("Spatial Mask", "Original", "Pruned", "Difference", "Wipe")]


def reload(tmp_path):
    bpy.ops.wm.save_as_mainfile(filepath=str(tmp_path / "file.blend"))
    bpy.ops.wm.open_mainfile(filepath=str(tmp_path / "file.blend"))


def test_images_are_the_same_after_save_and_reload(tmp_path, room, camera, stage, bridge):
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    bpy.ops.svrgs.spatial_mask()
    bpy.ops.svrgs.compare()
    before = {name: pixels(bpy.data.images[name]) for name in NAMES}
    modules = [part(f"operators.view.{name}") for name in ("spatial_mask", "compare")]
    figures = [module.figures() for module in modules]
    for _ in range(2):
        reload(tmp_path)
        for name, expected in before.items():
            assert expected[..., :3].max() > 0.1
            np.testing.assert_array_equal(pixels(bpy.data.images[name]), expected)
        assert all(figures) and [module.figures() for module in modules] == figures


def test_images_of_a_reopened_file_are_drawn_again_in_place(tmp_path, room, camera, stage, bridge):
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    stage.svrgs_view.wipe = 0.5
    bpy.ops.svrgs.spatial_mask()
    bpy.ops.svrgs.compare()
    reload(tmp_path)
    mask, wipe = (pixels(bpy.data.images[f"SVR-GS {name}"]) for name in ("Spatial Mask", "Wipe"))
    settings = bpy.context.scene.svrgs_view
    settings.mask_colors = "grey" if settings.mask_colors != "grey" else "values"
    settings.wipe = 1.0
    assert (pixels(bpy.data.images["SVR-GS Spatial Mask"]) != mask).any()
    assert (pixels(bpy.data.images["SVR-GS Wipe"]) != wipe).any()
    bpy.context.scene.camera.location.x += 1
    bpy.context.view_layer.update()
    bpy.ops.svrgs.spatial_mask()
    assert not [image.name for image in bpy.data.images if "former" in image.name]
