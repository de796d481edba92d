"""Groups of points that were moved together are found again, and shapes and colours follow them."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.scene.affine import transformed
from svrgs_addon.scene.moved_points import common_motion, follow_points, moved_parts


def similarity(seed: int, mirror: bool = False) -> np.ndarray:
    rng = np.random.default_rng(seed)
    Q, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    Q *= np.sign(np.linalg.det(Q)) * (-1 if mirror else 1)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = rng.uniform(0.3, 3) * Q, rng.normal(0, 10, 3)
    return matrix


def affine(seed: int) -> np.ndarray:
    matrix = similarity(seed)
    matrix[:3, :3] = matrix[:3, :3] @ np.diag((1, 2, 0.4))
    return matrix


def moved(points: np.ndarray, matrix: np.ndarray) -> np.ndarray:
    """In float32, as Blender computes."""
    A, t = matrix[:3, :3].astype(np.float32), matrix[:3, 3].astype(np.float32)
    return points @ A.T + t


def cloud(count: int, seed: int = 0) -> np.ndarray:
    """Points with floaters far away."""
    points = np.random.default_rng(seed).normal(0, 5, (count, 3))
    points[: count // 50] *= 30
    return points.astype(np.float32)


@pytest.mark.parametrize("count", [8, 50, 1500, 100_000])
@pytest.mark.parametrize(
    "matrix", [similarity(1), similarity(2, mirror=True), affine(3)], ids=["similarity", "mirrored", "affine"]
)
def test_one_motion_of_all_points(count, matrix):
    points = cloud(count)
    ((rows, found),) = moved_parts(points, moved(points, matrix))
    assert len(rows) == count
    np.testing.assert_allclose(found[:3, :3], matrix[:3, :3], atol=2e-6 if count > 8 else 1e-4)
    np.testing.assert_allclose(common_motion(points, moved(points, matrix)), found)


@pytest.mark.parametrize("count", [400, 50_000])
def test_joined_splats_each_have_a_motion(count):
    points, after, expected = cloud(count), cloud(count), {}
    for number, rows in enumerate(np.array_split(np.arange(count), 8)[1:]):  # the first stays
        matrix = affine(number) if number % 3 == 0 else similarity(number, mirror=number % 2 == 0)
        after[rows] = moved(points[rows], matrix)
        expected[rows[0]] = rows, matrix
    found = list(moved_parts(points, after))
    assert len(found) == 7
    for rows, matrix in found:
        assert (rows == expected[rows[0]][0]).all()
        np.testing.assert_allclose(matrix[:3, :3], expected[rows[0]][1][:3, :3], atol=1e-5)
    assert common_motion(points, after) is None


def test_a_selection_that_was_rotated_in_edit_mode():
    points = cloud(5000)
    chosen = np.random.default_rng(1).random(5000) < 0.3
    after = np.where(chosen[:, None], moved(points, similarity(4)), points)
    ((rows, _),) = moved_parts(points, after)
    assert set(rows) == set(np.flatnonzero(chosen))


@pytest.mark.parametrize("change", ["nothing", "shift", "noise", "wave", "lost record", "not finite"])
def test_shapes_stay_where_points_were_not_turned_or_scaled_together(change):
    points = cloud(3000)
    rng = np.random.default_rng(2)
    before, after = {
        "nothing": (points, points),
        "shift": (points, points + np.float32(3)),
        "noise": (points, points + rng.normal(0, 0.1, points.shape).astype(np.float32)),
        "wave": (points, points + np.sin(points[:, :1]) * np.float32((0, 0, 1))),
        "lost record": (np.zeros_like(points), points),
        "not finite": (points, np.full_like(points, np.nan)),
    }[change]
    assert not list(moved_parts(before, after))
    scene = replace(scenes.random_scene(3000), means=np.ascontiguousarray(after))
    assert follow_points(scene, before) == (scene, 0)


def test_points_in_a_plane_are_rotated_not_mirrored():
    flat = cloud(200) * np.float32((1, 1, 0))
    ((_, matrix),) = moved_parts(flat, moved(flat, similarity(5)))
    np.testing.assert_allclose(matrix, similarity(5), atol=1e-4)


@pytest.mark.parametrize(
    "matrix", [similarity(6), similarity(7, mirror=True)], ids=["similarity", "mirrored"]
)
def test_shapes_and_colours_follow_as_if_the_scene_had_been_transformed(matrix):
    scene = scenes.random_scene(500, sh_degree=3)
    expected = transformed(scene, matrix)
    stale = replace(scene, means=moved(scene.means, matrix))
    found, count = follow_points(stale, scene.means)
    assert count == 500
    np.testing.assert_allclose(found.log_scales, expected.log_scales, atol=2e-6)
    np.testing.assert_allclose(found.sh, expected.sh, atol=2e-6)
    same_turn = np.abs((found.quats * expected.quats).sum(axis=1)) / (
        np.linalg.norm(found.quats, axis=1) * np.linalg.norm(expected.quats, axis=1)
    )
    np.testing.assert_allclose(same_turn, 1, atol=1e-6)
    assert found.means is stale.means


@pytest.mark.parametrize("count", [20, 300])
def test_each_of_hundreds_of_instances_has_a_motion(count):
    """As geometry nodes realise them: each less than the smallest share of a group that is searched for."""
    matrices = [(affine if number % 3 else similarity)(number) for number in range(400)]
    one = cloud(count)
    before, after = np.tile(one, (400, 1)), np.concatenate([moved(one, matrix) for matrix in matrices])
    found = list(moved_parts(before, after))
    assert sum(len(rows) for rows, _ in found) > 0.999 * len(before)
    for rows, matrix in found:
        expected = matrices[rows[0] // count]
        assert (rows // count == rows[0] // count).mean() > 0.99
        np.testing.assert_allclose(matrix[:3, :3], expected[:3, :3], atol=1e-4)


def test_small_instances_beside_a_large_one_have_motions_too():
    """All of them together are less than the smallest share of a group that is searched for."""
    matrices = [affine(0), similarity(1), affine(2)]
    parts = [cloud(count) for count in (40_000, 60, 60)]
    before = np.concatenate(parts)
    after = np.concatenate([moved(one, matrix) for one, matrix in zip(parts, matrices, strict=True)])
    assert [len(rows) for rows, _ in moved_parts(before, after)] == [40_000, 60, 60]
