"""Gaussians that a pixel blends."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render.overdraw import overdraw
from svrgs_bench.scenes import orbit_camera, room


def test_layers_that_fill_the_picture_are_counted_behind_opaque_ones_too():
    scene = room(5, 0)
    means = np.zeros((5, 3), np.float32)
    means[:, 1] = np.arange(5) * 0.01
    scene = replace(
        scene,
        means=means,
        log_scales=np.full((5, 3), 4.0, np.float32),
        opacity_logits=np.full(5, 8.0, np.float32),
    )
    camera = orbit_camera(16, 9)
    assert overdraw(scene, [camera]) == 5
    assert overdraw(scene.select(np.array([0, 3])), [camera]) == 2


def test_it_is_the_mean_over_the_pixels_of_all_views():
    scene = room(200)
    views = [orbit_camera(32, 18, turn) for turn in (0.0, 90.0)]
    hits = [
        Rasterizer().forward(scene, view, RenderOptions(mask_kind="svr"), outputs=("hits",))["hits"]
        for view in views
    ]
    assert overdraw(scene, views) == pytest.approx(np.mean(hits)) and np.max(hits) > 0
