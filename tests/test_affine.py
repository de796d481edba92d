"""Scenes in other coordinates: what is seen stays the same when scene and camera move together."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from reference.rasterize import view_colours
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.affine import stretch, transformed
from svrgs_addon.scene.rotations import quats_from_matrices, rotation_matrices
from svrgs_addon.scene.sh_rotation import band_rotation, rotate_sh
from svrgs_addon.system.errors import SceneError


def some_rotation(seed: int) -> np.ndarray:
    return rotation_matrices(np.random.default_rng(seed).normal(size=(1, 4)))[0]


def affine(A: np.ndarray, t=(0, 0, 0)) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = A, t
    return matrix


def colours(sh: np.ndarray, directions: np.ndarray, degree: int) -> np.ndarray:
    """What the reference shows of Gaussians (n) seen along directions (n, 3) from the origin."""
    return view_colours(
        torch.tensor(directions),
        torch.tensor(sh, dtype=torch.float64),
        torch.eye(4, dtype=torch.float64),
        degree,
    ).numpy()


@pytest.mark.parametrize("degree", range(4))
@pytest.mark.parametrize("mirror", [1, -1], ids=["rotation", "mirroring"])
def test_rotated_harmonics_at_rotated_directions_are_the_old_colours(degree, mirror):
    rng = np.random.default_rng(degree)
    R = mirror * some_rotation(degree)
    directions = rng.normal(size=(500, 3))
    sh = scenes.random_scene(500, degree, degree).sh + np.float32(3) * (np.arange((degree + 1) ** 2) == 0)[
        None, :, None
    ].astype(np.float32)
    before, after = colours(sh, directions, degree), colours(rotate_sh(sh, R), directions @ R.T, degree)
    assert before.min() > 0, "no colour is cut off, or the test would not see it"
    np.testing.assert_allclose(after, before, atol=3e-7)  # seen: 1.3e-7, float32 rounding of the coefficients


@pytest.mark.parametrize("degree", (1, 2, 3))
def test_band_rotations_are_a_representation(degree):
    P, Q = some_rotation(1), some_rotation(2)
    D = band_rotation(degree, P)
    np.testing.assert_allclose(D @ D.T, np.eye(2 * degree + 1), atol=1e-13)
    np.testing.assert_allclose(band_rotation(degree, P @ Q), D @ band_rotation(degree, Q), atol=1e-13)


def test_quaternions_of_matrices_in_every_branch():
    quats = np.concatenate(
        [
            np.eye(4),
            np.random.default_rng(0).normal(size=(200, 4)),
            [[1e-9, 1, 0, 0], [0, 1, 1, 0], [1, -1, -1, 1]],
        ]
    )
    R = rotation_matrices(quats)
    np.testing.assert_allclose(rotation_matrices(quats_from_matrices(R)), R, atol=1e-14)


@pytest.mark.parametrize("mirror", [1, -1], ids=["rotation", "mirroring"])
def test_scene_and_camera_moved_together_show_the_same_picture(mirror):
    # nothing near the camera: the near plane does not move along
    scene, camera = scenes.random_scene(300, 3, spread=0.4), scenes.CAMERAS["rotated"]
    matrix = affine(mirror * 2.5 * some_rotation(4), (1, -2, 3))
    moved = transformed(scene, matrix)
    if mirror < 0:  # no camera shows a mirrored world as it was: mirror it back
        back = affine(-np.eye(3), (4, 5, 6))
        moved, matrix = transformed(moved, back), back @ matrix
    viewmat = camera.viewmat @ np.linalg.inv(matrix)
    viewmat[:3] *= 2.5  # rigid again: all is 2.5 times as far away
    draw = lambda scene, camera: Rasterizer("float64").forward(as_float64(scene), camera, RenderOptions())[
        "rgb"
    ]
    before, after = draw(scene, camera), draw(moved, replace(camera, viewmat=viewmat))
    assert before.std() > 0.05
    assert np.abs(after - before).max() < 2e-5


def as_float64(scene):
    class Wide:
        """A scene for the double kernels."""

    wide = Wide()
    for name, value in vars(scene).items():
        setattr(wide, name, value.astype(np.float64) if isinstance(value, np.ndarray) else value)
    wide.count, wide.sh_degree = scene.count, scene.sh_degree
    return wide


def covariances(scene) -> np.ndarray:
    axes = rotation_matrices(scene.quats) * np.exp(scene.log_scales.astype(np.float64))[:, None, :]
    return axes @ axes.transpose(0, 2, 1)


@pytest.mark.parametrize("scales", [(2, 2, 2), (1, 2, 0.5), (-1, 3, 1)])
def test_covariances_are_those_of_the_stretched_space(scales):
    scene = scenes.random_scene(200, 5)
    A = some_rotation(6) @ np.diag(scales) @ some_rotation(7)
    found, expected = covariances(transformed(scene, affine(A))), A @ covariances(scene) @ A.T
    assert (np.abs(found - expected).max(axis=(1, 2)) < 2e-6 * np.abs(expected).max(axis=(1, 2))).all()


def test_stretch_says_whether_shapes_are_kept():
    assert stretch(affine(3 * some_rotation(1))) == pytest.approx(1, abs=1e-12)
    assert stretch(affine(some_rotation(1) @ np.diag((1, 2, 0.5)))) == pytest.approx(4)


@pytest.mark.parametrize("A", [np.zeros((3, 3)), np.diag((1, 1, 0)), np.full((3, 3), np.nan)])
def test_a_matrix_that_flattens_space_is_refused(A):
    with pytest.raises(SceneError, match="scale of the object is zero or not finite"):
        transformed(scenes.random_scene(3), affine(A))
