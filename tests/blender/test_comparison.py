"""Comparisons of two splats: pictures, measures, the wipe, and the contact sheet."""

from __future__ import annotations

import math
from types import SimpleNamespace

import bpy
import numpy as np
import pytest
from extension import DATA, part
from job_helpers import Layout, draw_panel
from mathutils import Matrix
from view_helpers import LEVEL, mark_removed, pixels

pytestmark = pytest.mark.usefixtures("stage")


def test_compare_draws_both_and_measures_against_the_photograph(tmp_path, stage, bridge, ply):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    scene = bridge.scene_from_object(splat)
    with pytest.raises(RuntimeError, match="nothing to compare"):
        bpy.ops.svrgs.compare()
    mark_removed(splat, np.arange(scene.count) % 3 == 0)
    bpy.ops.svrgs.compare()
    result = part("operators.view.compare").figures()
    assert result["original"]["count"] == scene.count
    assert result["pruned"]["count"] == scene.count - len(range(0, scene.count, 3))
    ply.write_ply(tmp_path / "scene.ply", scene)
    assert result["original"]["bytes"] == (tmp_path / "scene.ply").stat().st_size
    original, pruned, difference = (
        pixels(bpy.data.images[f"SVR-GS {name}"])[..., :3] for name in ("Original", "Pruned", "Difference")
    )
    np.testing.assert_allclose(difference, np.minimum(4 * np.abs(original - pruned), 1), atol=3 * LEVEL)
    photo = pixels(bpy.data.images.load(str(DATA / f"tiny/images/{result['camera']}")))[..., :3]
    for picture, row in ((original, result["original"]), (pruned, result["pruned"])):
        assert math.isclose(row["psnr"], -10 * math.log10(np.mean((picture - photo) ** 2)), rel_tol=1e-3)
        assert 0 < row["ssim"] <= 1 and 0 <= row["flip"] < 1


def test_what_is_too_near_to_be_drawn_is_so_in_both(bridge):
    """Also where pruning leaves a splat so much smaller that it alone would have a unit of its own."""
    compare, visible = part("operators.view.compare"), part("operators.data.visible_splats")
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    scene = bridge.scene_from_object(bpy.context.object)
    small = part("svrgs_addon.scene.affine").scaled(scene, 0.2)
    whole = part("svrgs_addon.scene.concatenate").concatenated([small, scene])
    camera = part("svrgs_addon.scene.camera").Camera(np.eye(4), np.diag([50.0, 50, 1]), 64, 48)
    seen = []
    forward = lambda scene, view, options: seen.append(view.unit) or {"rgb": np.zeros((1, 1, 3))}
    pair = SimpleNamespace(
        placed=[visible.placed([(one, Matrix())]) for one in (whole, small)],
        rasterizer=SimpleNamespace(forward=forward),
    )
    compare.ComparedSplats.render(pair, camera, (0, 0, 0))
    alone = pair.placed[1].seen_by(camera).unit
    assert seen[0] == seen[1] and alone < seen[0]


@pytest.mark.parametrize("outside", ["auto", "background"])
def test_compare_counts_no_pixel_that_the_mask_hides(tmp_path, stage, outside):
    """Those that are painted count. The masks are those of the folder that was chosen for jobs."""
    compare, settings = part("operators.view.compare"), stage.svrgs_prune
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    mark_removed(splat, np.arange(250) % 3 == 0)
    mask = np.full((48, 64), 255, np.uint8)
    mask[:12] = 0
    photo = stage.camera.data["svrgs_image"]
    part("svrgs_addon.files.images").write_image(tmp_path / f"{photo}.png", mask)
    settings.masks, settings.outside = str(tmp_path), outside
    try:
        bpy.ops.svrgs.compare()
        figures, layout = compare.figures(), Layout()
        draw_panel(part("panels.compare"), layout)
        if outside == "auto":
            part("svrgs_addon.files.images").write_image(tmp_path / f"{photo}.png", 0 * mask)
            with pytest.raises(RuntimeError, match="hides the whole photograph"):
                bpy.ops.svrgs.compare()
    finally:
        settings.masks, settings.outside = "", "auto"
    pruned = pixels(bpy.data.images["SVR-GS Pruned"])[..., :3]
    wanted = pixels(bpy.data.images.load(str(DATA / f"tiny/images/{photo}")))[..., :3]
    if outside == "background":
        wanted[:12] = 0
    shown = slice(12, None) if outside == "auto" else slice(None)
    error = np.mean((pruned[shown] - wanted[shown]) ** 2)
    assert math.isclose(figures["pruned"]["psnr"], -10 * math.log10(error), rel_tol=1e-3)
    assert ("25.0% of it is masked out" in layout.text) == (outside == "auto")


def test_compare_measures_lpips_where_its_weights_are(tmp_path, stage, monkeypatch):
    """In a thread; without a window Blender waits for it."""
    lpips, compare = part("svrgs_addon.render.metrics.lpips"), part("operators.view.compare")
    rng = np.random.default_rng(0)
    arrays = {name: rng.random(shape, np.float32) - 0.45 for name, shape in lpips._expected().items()}
    scale = {name: (2 / max(1, np.prod(array.shape[1:]))) ** 0.5 for name, array in arrays.items()}
    np.savez(tmp_path / "w.npz", **{name: array * scale[name] for name, array in arrays.items()})
    monkeypatch.setenv(lpips.VARIABLE, str(tmp_path / "w.npz"))
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    mark_removed(splat, np.arange(250) % 3 == 0)
    bpy.ops.svrgs.compare()
    rows = [compare.figures()[name]["lpips"] for name in ("original", "pruned")]
    layout = Layout()
    draw_panel(part("panels.compare"), layout)
    assert rows[0] != rows[1] and "LPIPS" in layout.text and f"{rows[0]:.4f}" in layout.text
    (tmp_path / "w.npz").write_bytes(b"nothing")
    bpy.ops.svrgs.compare()
    assert "cannot be read as LPIPS weights" in compare.figures()["lpips_missing"]


def test_the_panel_names_the_pair_that_it_guesses(stage, room, camera):
    compare = part("operators.view.compare")
    assert compare.guessed(bpy.context) == {}
    mark_removed(room, np.arange(3000) % 2)
    assert compare.guessed(bpy.context) == {"original": "room", "pruned": "room", "compare_camera": "camera"}
    layout = Layout()
    draw_panel(part("panels.compare"), layout)
    assert [note[2:] for note in layout.notes if note[0] == "prop"][:3] == [
        ("original", "room"),
        ("pruned", "room"),
        ("compare_camera", "camera"),
    ]


def test_the_picture_opens_in_a_window_where_there_is_one():
    with pytest.raises(RuntimeError, match="without a window"):
        bpy.ops.svrgs.open_image(name="SVR-GS Wipe")


def test_the_wipe_moves(stage, bridge, room, camera):
    mark_removed(room, np.arange(bridge.count(room)) % 2)
    bpy.ops.svrgs.compare()
    original, pruned = (pixels(bpy.data.images[f"SVR-GS {name}"]) for name in ("Original", "Pruned"))
    for share in (0.0, 0.3, 1.0):
        stage.svrgs_view.wipe = share
        wipe, edge = pixels(bpy.data.images["SVR-GS Wipe"]), round(share * 101)
        np.testing.assert_array_equal(wipe[:, :edge], original[:, :edge])
        np.testing.assert_array_equal(wipe[:, edge:], pruned[:, edge:])


def test_a_contact_sheet_of_all_cameras(stage):
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    splat = bpy.context.object
    bpy.ops.svrgs.import_colmap(directory=str(DATA / "tiny"))
    bpy.context.view_layer.objects.active = splat
    stage.svrgs_view.pruned = splat
    bpy.ops.svrgs.contact_sheet()
    width, height = bpy.data.images["SVR-GS Contact Sheet"].size
    assert width == 2 * (3 * 64 + 2 * 4) + 12 and height == 6 * 48 + 5 * 4
