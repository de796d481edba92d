"""Colour grading of splats: what it makes of pictures, on the command line as in the function."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.grade import LUMA, Grade, graded
from svrgs_bench.scenes import orbit_camera, room

GRADES = {
    "exposure": Grade(exposure=0.7),
    "white balance": Grade(warmth=0.4, tint=-0.3),
    "saturation": Grade(saturation=0.2),
    "contrast": Grade(contrast=0.6),
    "all": Grade(-0.5, 0.2, 0.3, 1.2, 0.8),
}


@pytest.mark.parametrize("name", GRADES)
def test_a_picture_is_graded_as_its_colours(name):
    """Where no colour is clamped at 0: A C + b alpha of the picture C over black."""
    scene, camera, r = room(2_000), orbit_camera(96, 70), Rasterizer()
    scene = replace(scene, sh=np.ascontiguousarray(0.2 * scene.sh))  # colours around 0.5
    grade, options = GRADES[name], render_options(scene)
    before, after = (
        {
            key: image.copy()
            for key, image in r.forward(one, camera, options, outputs=("rgb", "alpha")).items()
        }
        for one in (scene, graded(scene, grade))
    )
    matrix = grade.matrix
    expected = before["rgb"] @ matrix[:, :3].T + matrix[:, 3] * before["alpha"][..., None]
    assert np.abs(expected - before["rgb"]).max() > 0.02
    np.testing.assert_allclose(after["rgb"], expected, atol=2e-6)
    np.testing.assert_array_equal(after["alpha"], before["alpha"])


def test_what_the_controls_mean():
    grey, matrix = np.full(3, 0.5), lambda **values: Grade(**values).matrix
    apply = lambda colour, m: m[:, :3] @ colour + m[:, 3]
    np.testing.assert_allclose(apply(grey, matrix(exposure=1)) / 0.5, 2 ** (1 / 2.2))
    red, green, blue = apply(grey, matrix(warmth=1))
    assert red > green > blue and green == 0.5
    red, green, blue = apply(grey, matrix(tint=1))
    assert red == blue > green
    colour = np.array([0.2, 0.7, 0.4])
    np.testing.assert_allclose(apply(colour, matrix(saturation=0)), LUMA @ colour)
    np.testing.assert_allclose(apply(grey, matrix(contrast=3)), grey)


def test_opacities_are_multiplied():
    scene = room(500)
    opacities = [
        1 / (1 + np.exp(-one.opacity_logits.astype(np.float64)))
        for one in (scene, graded(scene, Grade(opacity=0.4)))
    ]
    np.testing.assert_allclose(opacities[1], 0.4 * opacities[0], rtol=1e-5, atol=2e-6)
    assert np.isfinite(graded(scene, Grade(opacity=0)).opacity_logits).all()


def test_no_grade_changes_no_bit_and_makes_no_copy():
    scene = room(10)
    assert graded(scene, Grade()) is scene


def test_convert_grades(tmp_path, svrgs):
    scene = room(300)
    write_ply(tmp_path / "a.ply", scene)
    words = "--exposure 0.5 --warmth 0.2 --tint -0.1 --saturation 1.3 --contrast 0.9 --opacity 0.7"
    svrgs("convert", tmp_path / "a.ply", tmp_path / "b.ply", words)
    expected, found = graded(scene, Grade(0.5, 0.2, -0.1, 1.3, 0.9, 0.7)), read_ply(tmp_path / "b.ply")
    np.testing.assert_array_equal(found.sh, expected.sh)
    np.testing.assert_array_equal(found.opacity_logits, expected.opacity_logits)


@pytest.mark.parametrize("softness", [0.0, 0.5])
def test_what_is_outside_the_box_is_gone_and_what_is_near_its_faces_fades(softness):
    scene = room(3_000)
    middle, half = scene.means.mean(axis=0).astype(np.float64), 1.3 * scene.means.std(axis=0)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = np.diag(1 / half), -middle / half
    found = graded(scene, Grade(crop=tuple(map(tuple, matrix.tolist())), softness=softness))
    depth = 1 - np.abs((scene.means - middle) / half).max(axis=1)
    kept = depth > 0
    assert 0 < kept.sum() < scene.count
    np.testing.assert_array_equal(found.means, scene.means[kept])
    share = np.clip(depth[kept] / softness, 0, 1) if softness else np.ones(kept.sum())
    factors = share**2 * (3 - 2 * share)
    before, after = (
        1 / (1 + np.exp(-one.astype(np.float64)))
        for one in (scene.opacity_logits[kept], found.opacity_logits)
    )
    np.testing.assert_allclose(after, factors * before, rtol=1e-5, atol=2e-6)
