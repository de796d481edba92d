"""Files of Mip-Splatting: the 3D filter is baked in, and said."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.files.ply import write_ply
from svrgs_addon.files.registry import load_scene, write_scene
from svrgs_addon.files.repair import bake_filter


def filtered_scene(widths: np.ndarray):
    """A scene with the column filter_3D (N,)."""
    return replace(
        scenes.random_scene(len(widths), 4, 1, scale=0.2), attributes={"filter_3D": widths.astype(np.float32)}
    )


def test_scales_grow_and_opacities_shrink_as_the_filter_says():
    widths = np.geomspace(1e-3, 1.0, 50)
    scene = filtered_scene(widths)
    baked, filtered = bake_filter(scene)
    assert filtered and "filter_3D" not in baked.attributes
    squares = np.exp(2 * scene.log_scales.astype(np.float64))
    grown = squares + scene.attributes["filter_3D"].astype(np.float64)[:, None] ** 2
    opacity = (
        1
        / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))
        * np.sqrt(squares.prod(axis=1) / grown.prod(axis=1))
    )
    np.testing.assert_allclose(np.exp(2 * baked.log_scales.astype(np.float64)), grown, rtol=1e-5)
    np.testing.assert_allclose(1 / (1 + np.exp(-baked.opacity_logits.astype(np.float64))), opacity, rtol=1e-5)
    for name in ("means", "quats", "sh"):
        assert np.array_equal(getattr(baked, name), getattr(scene, name))


def test_a_filter_of_width_0_changes_nothing():
    scene = filtered_scene(np.zeros(20))
    baked, _ = bake_filter(scene)
    assert np.array_equal(baked.log_scales, scene.log_scales)
    np.testing.assert_allclose(baked.opacity_logits, scene.opacity_logits, rtol=1e-5, atol=1e-6)


def test_a_scene_without_the_column_is_left_alone():
    scene = scenes.random_scene(5, 4, 1)
    assert bake_filter(scene) == (scene, False)


def test_a_file_is_baked_once_and_it_is_said(tmp_path, caplog):
    write_ply(tmp_path / "mip.ply", filtered_scene(np.full(10, 0.1)))
    with caplog.at_level(logging.WARNING):
        first = load_scene(tmp_path / "mip.ply")
    assert "mip.ply: the 3D filter of Mip-Splatting was baked" in caplog.text
    write_scene(tmp_path / "again.ply", first)
    caplog.clear()
    second = load_scene(tmp_path / "again.ply")
    assert not caplog.text and np.array_equal(first.log_scales, second.log_scales)
    assert np.array_equal(first.opacity_logits, second.opacity_logits)


@pytest.mark.parametrize("width", [np.nan, np.inf])
def test_gaussians_with_a_filter_that_is_no_number_are_dropped(tmp_path, width):
    widths = np.full(10, 0.1)
    widths[3] = width
    write_ply(tmp_path / "mip.ply", filtered_scene(widths))
    assert load_scene(tmp_path / "mip.ply").count == 9
