"""What a graphics card is given, against the rasterizer's own numbers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from reference import rasterize as ref
from svrgs_addon.native.pictures import depth_order
from svrgs_addon.render.quads import HIGHLIGHT, TINT, colors, highlighted, quads, recolored
from svrgs_addon.scene.activation import opacities
from svrgs_addon.scene.gaussians import SH_C0
from svrgs_addon.scene.rotations import rotation_matrices
from svrgs_bench.scenes import orbit_camera, room


def test_each_gaussian_has_its_mean_opacity_and_covariance_once():
    scene = scenes.random_scene(500)
    cloud = quads(scene, 1000)
    np.testing.assert_array_equal(quads(scene, 20).geometry, cloud.geometry[:20])
    assert sorted(cloud.rows) == list(range(500)) and (np.diff(cloud.rows) < 0).any()
    np.testing.assert_array_equal(cloud.means, scene.means[cloud.rows])
    np.testing.assert_array_equal(
        cloud.geometry[:, 0], np.column_stack([cloud.means, opacities(scene.opacity_logits)[cloud.rows]])
    )
    R, S = rotation_matrices(scene.quats), np.exp(2 * scene.log_scales.astype(np.float64))
    covariance = np.einsum("nij,nj,nkj->nik", R, S, R)[cloud.rows]
    np.testing.assert_allclose(cloud.geometry[:, 1, :3], covariance[:, 0], rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(
        cloud.geometry[:, 2, :3], covariance[:, [1, 1, 2], [1, 2, 2]], rtol=1e-5, atol=1e-6
    )


@pytest.mark.parametrize(
    "values",
    [
        np.random.default_rng(0).normal(size=5000),
        np.repeat([3.0, -1.0, 0.0, 1e30, -1e-30], 40),
        np.array([0.0, -0.0, 0.0]),
        np.empty(0),
    ],
)
def test_the_order_is_that_of_the_depths(values):
    means = np.zeros((len(values), 3), np.float32)
    means[:, 2] = values
    np.testing.assert_array_equal(
        depth_order(means, np.array([0, 0, 1.0])), np.argsort(-means[:, 2], kind="stable")
    )


@pytest.mark.parametrize("orthographic", [False, True])
def test_colours_are_the_rasterizers(orthographic):
    scene, camera = room(300), replace(orbit_camera(32, 32), orthographic=orthographic)
    rows = np.arange(300)[::-1].copy()
    means, sh, viewmat = (
        torch.tensor(array, dtype=torch.float64)
        for array in (scene.means[rows], scene.sh[rows], camera.viewmat)
    )
    expected = ref.view_colours(means, sh, viewmat, 3, orthographic)
    np.testing.assert_allclose(colors(scene, rows, camera), expected.clamp(min=0), atol=1e-5)


def test_a_recoloured_scene_has_these_colours_from_everywhere():
    scene, rgb = room(50), np.random.default_rng(0).random((50, 3))
    for turn in (0.0, 120.0):
        np.testing.assert_allclose(
            colors(recolored(scene, rgb), np.arange(50), orbit_camera(32, 32, turn)), rgb, atol=1e-6
        )


def test_marked_gaussians_are_tinted_and_the_others_stay():
    scene = scenes.random_scene(40, 3, 2)
    marks = np.arange(30) % 3 == 0
    shown = highlighted(scene, [30, 10], [marks.astype(np.float32), None])
    chosen = np.concatenate([marks, np.zeros(10, bool)])
    assert (shown.sh[~chosen] == scene.sh[~chosen]).all() and shown.means is scene.means
    before, after = 0.5 + SH_C0 * scene.sh[chosen, 0], 0.5 + SH_C0 * shown.sh[chosen, 0]
    assert after == pytest.approx((1 - TINT) * before + TINT * np.array(HIGHLIGHT), abs=1e-6)
    assert shown.sh[chosen, 1:] == pytest.approx((1 - TINT) * scene.sh[chosen, 1:], abs=1e-7)
