"""Up is found from the rotations of cameras, and a matrix is turned until it points up."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.scene.upright import levelled, tilt, up_direction

Z = np.array([0.0, 0.0, 1.0])


def look(yaw: float, pitch: float, roll: float = 0.0) -> np.ndarray:
    """World-to-camera rotation (3, 3) in a world with z up; angles in degrees, pitch downwards."""
    y, p, r = np.radians((yaw, pitch, roll))
    forward = np.array([np.cos(y) * np.cos(p), np.sin(y) * np.cos(p), -np.sin(p)])
    right = np.array([np.sin(y), -np.cos(y), 0.0])
    down = np.cross(forward, right)
    return np.array([np.cos(r) * right + np.sin(r) * down, np.cos(r) * down - np.sin(r) * right, forward])


def noisy(angles, sigma: float, seed: int = 0) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return np.array([look(*(np.array(a, float) + rng.normal(0, sigma, len(a)))) for a in angles])


RING = [(10 * i, 20, 0) for i in range(36)]
CAPTURES = {
    "ring": (noisy(RING, 2), 2.0),
    "half a ring, looking down": (noisy([(5 * i, 45, 0) for i in range(36)], 2), 2.0),
    "a quarter of them rolled": (noisy(RING + [(30 * i, 20, 90) for i in range(12)], 2), 2.0),
    "street": (noisy([(0, 0, 0)] * 30, 1), 8.0),
    "street, a quarter of them rolled": (noisy([(0, 0, 0)] * 30 + [(0, 0, -90)] * 10, 1), 8.0),
    "drone, looking straight down": (
        noisy([(15 * (i % 5) + 180 * (i % 2), 90, 0) for i in range(30)], 1),
        5.0,
    ),
    "ceiling": (noisy([(10 * i, -75, 0) for i in range(36)], 2), 2.0),
}


@pytest.mark.parametrize("name", CAPTURES)
def test_up_of_captures(name):
    rotations, bound = CAPTURES[name]
    turn = look(33, 21, 64)  # of the world, which is arbitrary in COLMAP
    up = up_direction(rotations @ turn.T)
    assert np.degrees(np.arccos(up @ (turn @ Z))) < bound


def test_no_up_without_a_consensus():
    rng = np.random.default_rng(0)
    anyhow = np.linalg.qr(rng.normal(size=(60, 3, 3)))[0]
    anyhow *= np.linalg.det(anyhow)[:, None, None]
    assert up_direction(anyhow) is None
    # half of them upside down
    assert up_direction(np.array([look(10 * i, 20, 180 * (i % 2)) for i in range(36)])) is None
    assert up_direction(np.array([look(0, 0), look(90, 0)])) is None, "two photographs are too few"


def test_real_captures(shared_data):
    """Held against the plane of the bed, the street's direction, and the ground below a drone."""
    pytest.importorskip("pycolmap")
    from svrgs_addon.views.dataset import load_dataset

    for name, plane, bound in (
        ("snowmiku_plush", (0, -0.83, -0.55), 10),
        ("lund_street", (0, -1, 0), 6),
        ("brighton_beach", (0, 0, -1), 11),
    ):
        cameras = load_dataset(shared_data / name, cameras_only=True).cameras
        up = up_direction(np.array([camera.viewmat[:3, :3] for camera in cameras]))
        assert np.degrees(np.arccos(up @ np.array(plane) / np.linalg.norm(plane))) < bound, name


@pytest.mark.parametrize("up", [(0, 0, 1), (0, 0, -1), (0, -1, 0), (1, 2, -3)])
def test_a_levelled_matrix_keeps_scale_and_place(up):
    up = np.array(up, float) / np.linalg.norm(up)
    matrix = np.eye(4)
    matrix[:3, :3], matrix[:3, 3] = 2.5 * look(10, 20, 30), (1, 2, 3)
    turned = levelled(matrix, up)
    assert np.allclose(turned[:3, :3] @ up, 2.5 * Z) and np.allclose(turned[:3, 3], (1, 2, 3))
    assert np.allclose(turned[:3, :3].T @ turned[:3, :3], 2.5**2 * np.eye(3)) and np.linalg.det(turned) > 0
    assert tilt(turned, up) < 1e-5
    moved = np.degrees(np.arccos((np.trace(turned[:3, :3] @ np.linalg.inv(matrix[:3, :3])) - 1) / 2))
    assert np.isclose(moved, tilt(matrix, up)), "the shortest way"


def test_half_a_turn():
    assert np.allclose(levelled(np.eye(4), -Z), np.diag([1, -1, -1, 1]))
