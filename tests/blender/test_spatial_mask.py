"""The spatial mask as an image that follows what it shows, and contributions as an attribute."""

from __future__ import annotations

import math

import bpy
import numpy as np
import pytest
from extension import part
from view_helpers import drawn, mark_removed, pixels, view_of

pytestmark = pytest.mark.usefixtures("stage")


def test_the_spatial_mask_is_an_image_and_a_texture(stage, gaussians, room, camera):
    looking = stage.svrgs_view
    looking.mask_size, looking.mask_colors, looking.mask_top = 101, "values", 0
    bpy.ops.svrgs.spatial_mask()
    image = bpy.data.images["SVR-GS Spatial Mask"]
    assert image.is_float and image.colorspace_settings.name == "Non-Color" and tuple(image.size) == (101, 61)
    assert bpy.data.textures["SVR-GS Spatial Mask"].image == image
    expected = drawn(gaussians, camera, room.matrix_world, ("mask",), mask_kind="svr")["mask"]
    np.testing.assert_allclose(pixels(image)[..., 0], expected, atol=1e-3, rtol=1e-3)
    result = part("operators.view.spatial_mask").figures()
    assert result["camera"] == "camera" and math.isclose(result["largest"], expected.max(), rel_tol=1e-3)


def test_colours_of_the_mask_change_without_another_drawing(stage, room, camera):
    looking = stage.svrgs_view
    looking.mask_colors = "inferno"
    bpy.ops.svrgs.spatial_mask()
    image = bpy.data.images["SVR-GS Spatial Mask"]
    before = pixels(image).copy()
    looking.mask_colors = "viridis"
    assert bpy.data.images["SVR-GS Spatial Mask"] == image and np.abs(pixels(image) - before).max() > 0.1
    looking.mask_top = 1e9
    assert np.ptp(pixels(image)[..., :3], axis=(0, 1)).max() < 1e-3, "everything is near the lowest colour"
    looking.mask_top = 0


def test_the_mask_follows_edits(stage, gaussians, room, camera):
    bpy.ops.svrgs.spatial_mask()
    figures = part("operators.view.spatial_mask").figures
    before = figures()["mean"]
    mark_removed(room, np.arange(gaussians.count) % 2)
    bpy.ops.svrgs.spatial_mask()
    assert figures()["mean"] < before


def test_the_mask_is_drawn_anew_only_when_something_has_moved(stage, room, camera):
    spatial_mask = part("operators.view.spatial_mask")
    bpy.ops.svrgs.spatial_mask()
    assert not spatial_mask.is_stale(bpy.context)
    for move in (
        lambda: setattr(camera, "location", (0, -5, 1)),
        lambda: setattr(room, "scale", (2, 2, 2)),
        lambda: setattr(room, "hide_viewport", True),
    ):
        move()
        bpy.context.view_layer.update()
        assert spatial_mask.is_stale(bpy.context)
        if not room.hide_viewport:
            bpy.ops.svrgs.spatial_mask()
            assert not spatial_mask.is_stale(bpy.context)


def test_the_mask_is_drawn_anew_where_an_address_in_memory_is_used_again(
    gaussians, room, camera, monkeypatch
):
    spatial_mask = part("operators.view.spatial_mask")
    monkeypatch.setattr(spatial_mask, "id", lambda _: 0, raising=False)
    bpy.ops.svrgs.spatial_mask()
    mark_removed(room, np.arange(gaussians.count) % 2)
    assert spatial_mask.is_stale(bpy.context)


def test_the_mask_follows_in_the_scene_that_changed(stage, gaussians, room, camera):
    """Whichever scene is active when the time has come to draw."""
    follower = part("operators.view.spatial_mask")
    other = bpy.data.scenes.new("other")
    try:
        stage.svrgs_view.mask_follow, other.svrgs_view.mask_follow = False, True
        other.camera = bpy.data.objects.new("of the other", camera.data)
        for obj in (other.camera, room):
            other.collection.objects.link(obj)
        with bpy.context.temp_override(scene=other, view_layer=other.view_layers[0]):
            # as Blender does for a scene in a window
            follower._after_change(other, bpy.context.evaluated_depsgraph_get())
        follower._follow()
        assert part("operators.view.spatial_mask").figures()["camera"] == "of the other"
    finally:
        bpy.data.scenes.remove(other)
        stage.svrgs_view.mask_follow = False


def test_contribution_is_the_score(stage, gaussians, room, camera):
    bpy.ops.svrgs.contribution(cameras="ACTIVE")
    values = np.empty(gaussians.count, np.float32)
    room.data.attributes["contribution"].data.foreach_get("value", values)
    view = view_of(camera, stage).moved(room.matrix_world)
    viewed = part("svrgs_addon.finetune.viewed_scene").ViewedScene.of(gaussians, [view])
    expected, _, _ = part("svrgs_addon.finetune.scores").contribution(viewed)
    np.testing.assert_allclose(values, expected, rtol=1e-3, atol=1e-3)


def test_removal_error_is_that_of_the_cameras_and_is_shown(stage, gaussians, room, camera):
    with pytest.raises(RuntimeError, match="at least two views"):
        bpy.ops.svrgs.removal_error(cameras="ACTIVE")
    assert "removal_rank" not in room.data.attributes
    other = camera.copy()
    bpy.context.scene.collection.objects.link(other)
    try:
        other.location.x += 0.3
        bpy.context.view_layer.update()
        bpy.ops.svrgs.removal_error()
        views = [view_of(found, stage).moved(room.matrix_world) for found in (camera, other)]
    finally:
        bpy.data.objects.remove(other)
    expected = part("svrgs_addon.prune.selection.measure").measured(gaussians, views, all_looks=False)
    for name in ("removal_rank", "deciding_views", "rank_spread_views"):
        values = np.empty(gaussians.count, np.float32)
        room.data.attributes[name].data.foreach_get("value", values)
        np.testing.assert_allclose(values, expected[name], atol=5e-3)
    assert stage.svrgs_view.overlay_shown == "removal_rank"
    stage.svrgs_view.overlay_shown = "COLOR"
