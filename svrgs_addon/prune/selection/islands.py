"""Islands: Gaussians, and small groups of them, that hang in empty space, apart from everything else in the
scene.

Each visible Gaussian is linked to its nearest ones where the two touch, or where the gap between them is
ordinary for the place. Linked Gaussians form islands. An island with a tiny share of the scene is small. So a
thin thing such as an antenna stays, because it is a chain of links to the rest; and an object of its own
stays, because it is large enough.

Gaussians far from the middle of a scene are larger and farther apart (walls, trees, a sky). So ordinary gaps
are measured in proportion to the distance from the middle, and a background is not apart for being far.
"""

from __future__ import annotations

import numpy as np

from ...files.registry import invisible
from ...scene.bounds import robust_box
from ...scene.gaussians import Scene
from ...scene.neighbours import nearest_rows
from ...scene.rotations import rotation_matrices

# Gaussians that each one is compared with; with 8, the dense end of a strap is an island, because all of them
# are in it
NEIGHBOURS = 16
TOUCH = 2.0  # standard deviations of both, along the line between them, within which two Gaussians touch
GAP = 6.0  # ordinary gaps: up to this multiple of the median distance to the nearest Gaussian
ISLAND = 5e-4  # share of the visible Gaussians below which an island is small
MIN_COUNT = 2 * NEIGHBOURS  # Gaussians: a scene of fewer has no small islands


def on_small_islands(scene: Scene) -> np.ndarray:
    """(N,) bool: the visible Gaussians on islands with less than the share ISLAND of all visible ones. See
    the top of this file. scene: finite values. Invisible ones (opacity below 1/255) are on no island."""
    mask = np.zeros(scene.count, bool)
    rows = np.flatnonzero(~invisible(scene))
    if len(rows) < MIN_COUNT:
        return mask
    visible = scene.select(rows)
    near = nearest_rows(visible.means, NEIGHBOURS)
    labels = islands(near, links(visible, near))
    mask[rows] = np.bincount(labels, minlength=len(rows))[labels] < max(2, ISLAND * len(rows))
    return mask


def links(scene: Scene, near: np.ndarray) -> np.ndarray:
    """(N, k) bool: whether each Gaussian is linked to those of the rows near (N, k)."""
    axes = rotation_matrices(scene.quats) * np.exp(scene.log_scales.astype(np.float64))[:, None, :]
    means, linked = scene.means.astype(np.float64), np.empty(near.shape, bool)
    lines = [means[near[:, j]] - means for j in range(near.shape[1])]
    distances = np.stack([np.linalg.norm(line, axis=1) for line in lines], axis=1)
    ordinary = GAP * _usual_distance(scene, distances.min(axis=1))
    for j, line in enumerate(lines):
        touch = TOUCH * (_extent(axes, line) + _extent(axes[near[:, j]], line))
        linked[:, j] = distances[:, j] <= np.maximum(touch, np.minimum(ordinary, ordinary[near[:, j]]))
    return linked


def islands(near: np.ndarray, linked: np.ndarray) -> np.ndarray:
    """(N,) int64: for each row the smallest row of its island. Row i and row near[i, j] are in one island
    where linked[i, j].

    near: (N, k) int64. linked: (N, k) bool.
    """
    labels = np.arange(len(near))
    first, second = np.repeat(labels, near.shape[1])[linked.ravel()], near.ravel()[linked.ravel()]
    while True:
        least = np.minimum(labels[first], labels[second])
        before = labels.copy()
        np.minimum.at(labels, before[first], least)
        np.minimum.at(labels, before[second], least)
        while (labels[labels] != labels).any():
            labels = labels[labels]
        if np.array_equal(labels, before):
            return labels


def _usual_distance(scene: Scene, nearest: np.ndarray) -> np.ndarray:
    """The usual distance (N,) to the nearest Gaussian at the place of each: in proportion to its distance
    from the middle, from the edge of the middle on. nearest: (N,) the distances."""
    box = robust_box(scene.means, 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64))))
    assert box is not None  # all Gaussians are visible
    radius = max(np.linalg.norm(box[1] - box[0]) / 2, 1e-12)
    growth = np.maximum(np.linalg.norm(scene.means - box.mean(axis=0), axis=1) / radius, 1)
    return growth * np.median(nearest / growth)


def _extent(axes: np.ndarray, lines: np.ndarray) -> np.ndarray:
    """Standard deviations (N,) of Gaussians along lines (N, 3) through their centres. axes: (N, 3, 3), A with
    the covariance A Aᵀ."""
    lengths = np.maximum(np.linalg.norm(lines, axis=1), 1e-300)
    return np.linalg.norm(np.einsum("nij,ni->nj", axes, lines / lengths[:, None]), axis=1)
