"""Scenes in other colours, and the colours that a camera sees, against the reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from reference import rasterize as ref
from svrgs_addon.render.painting import HIGHLIGHT, TINT, colors, highlighted, recolored
from svrgs_addon.scene.gaussians import SH_C0
from svrgs_bench.scenes import orbit_camera, room


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
