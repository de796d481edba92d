"""Criteria of selections against plain loops, and what they make of bad values."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.files.registry import invisible
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.selection import criteria, haze
from svrgs_addon.prune.selection.islands import on_small_islands
from svrgs_addon.prune.selection.options import OF_VIEWS, Criteria
from svrgs_addon.prune.selection.select import selected
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import SceneError

SCENE = scenes.random_scene(200, seed=3)
CAMERAS = [scenes.CAMERAS[name] for name in ("rotated", "off_centre", "narrow")]


def views(named: str) -> list[Camera]:
    return CAMERAS if named in ("", "all") else [CAMERAS[int(named)]]


def loop(test) -> list[bool]:
    """The mask of a test of one row."""
    return [bool(test(row)) for row in range(SCENE.count)]


def chosen(scene: Scene = SCENE, **wanted) -> list[bool]:
    return selected(scene, Criteria(**wanted), views).tolist()


def test_box():
    corners = (0.5, -1.0, 0.3, -0.7, 2.0, -2.0)  # the axes in any order
    expected = loop(
        lambda row: all(
            min(corners[k], corners[k + 3]) <= SCENE.means[row, k] <= max(corners[k], corners[k + 3])
            for k in range(3)
        )
    )
    assert chosen(box=corners) == expected and 10 < sum(expected) < 190


def test_sphere():
    expected = loop(lambda row: math.dist(SCENE.means[row].astype(float), (0.2, 0.1, 0.0)) <= 1.1)
    assert chosen(sphere=(0.2, 0.1, 0.0, 1.1)) == expected and 10 < sum(expected) < 190


@pytest.mark.parametrize("shape", [{"box": (-1, -1, -1, 1, 1, 1)}, {"sphere": (0, 0, 0, 1)}])
def test_a_matrix_moves_centres_to_the_box_or_sphere(shape):
    matrix = np.eye(4)
    matrix[:3, :3] = np.diag([0.5, 2.0, 1.0]) @ [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    matrix[:3, 3] = 0.3, 0.0, -0.2
    moved = replace(
        SCENE, means=np.ascontiguousarray(SCENE.means @ matrix[:3, :3].T + matrix[:3, 3], np.float32)
    )
    assert selected(SCENE, Criteria(**shape), views, matrix).tolist() == chosen(moved, **shape)


def test_opacity_and_size():
    expected = loop(lambda row: 0.2 <= 1 / (1 + math.exp(-SCENE.opacity_logits[row])) <= 0.6)
    assert chosen(opacity=(0.2, 0.6)) == expected and 10 < sum(expected) < 190
    expected = loop(lambda row: math.exp(max(SCENE.log_scales[row])) >= 0.2)
    assert chosen(size=(0.2, math.inf)) == expected and 10 < sum(expected) < 190


def sums(name: str) -> np.ndarray:
    """Contribution, or removal error, from first principles: one picture with and one without the
    Gaussian."""
    rasterizer, options, result = Rasterizer(), render_options(SCENE), np.zeros(SCENE.count)
    for camera in CAMERAS:
        whole = rasterizer.forward(SCENE, camera, options)["rgb"].copy()
        for row in range(SCENE.count) if name == "removal_error" else ():
            masks = np.ones(SCENE.count, np.uint8)
            masks[row] = 0
            result[row] += ((rasterizer.forward(SCENE, camera, options, masks)["rgb"] - whole) ** 2).mean()
    return result


def test_removal_error_is_that_of_removing_one_gaussian(monkeypatch):
    monkeypatch.setattr("svrgs_addon.finetune.saliency.REDUCTION", 1)
    expected = sums("removal_error")
    middle = float(np.median(expected))
    sure = np.abs(expected / middle - 1) > 0.02
    assert (np.array(chosen(removal_error=(middle, math.inf))) == (expected >= middle))[sure].all()
    assert sure.sum() > 150


def test_contribution_and_views_are_those_of_the_rasterizer():
    rasterizer, total, peak = Rasterizer(), np.zeros(SCENE.count), np.zeros((3, SCENE.count), np.float32)
    for number, camera in enumerate(CAMERAS):
        rasterizer.forward(SCENE, camera, render_options(SCENE), outputs=())
        rasterizer.add_scores(total, peak[number], np.zeros(SCENE.count, np.int64))
    assert chosen(contribution=(1.0, 50.0)) == loop(lambda row: 1 <= total[row] <= 50)
    assert chosen(seen_by="all") == loop(lambda row: peak[:, row].max() >= 1 / 255)
    assert chosen(seen_by="2") == loop(lambda row: peak[2, row] >= 1 / 255) != chosen(seen_by="all")
    lowest = sorted(range(SCENE.count), key=lambda row: (total[row], row))[:50]
    assert chosen(lowest_contribution=0.25) == loop(lambda row: row in lowest)


def test_all_criteria_must_hold():
    both = np.array(chosen(opacity=(0.3, 1.0))) & chosen(sphere=(0, 0, 0, 1))
    assert chosen(opacity=(0.3, 1.0), sphere=(0, 0, 0, 1)) == both.tolist()


def test_nothing_and_everything():
    assert not any(chosen(opacity=(2.0, 3.0))) and all(chosen(opacity=(0.0, 1.0)))
    assert all(chosen(lowest_contribution=1.0))
    assert selected(scenes.empty_scene(), Criteria(opacity=(0, 1)), views).shape == (0,)


@pytest.mark.parametrize("name", ["box", "sphere", "opacity", "size", "floaters", *OF_VIEWS])
@pytest.mark.parametrize("count", [1, 200])
def test_rows_that_are_not_finite_are_never_selected(name, count):
    wide = {"box": (-9e9,) * 3 + (9e9,) * 3, "sphere": (0, 0, 0, 1e9), "seen_by": "all", "floaters": True}
    value = wide.get(name, 1.0 if "lowest" in name else (-math.inf, math.inf))
    scene = replace(SCENE.select(np.arange(count)))
    scene.means[0, 1], scene.log_scales[-1, 2] = np.nan, np.inf
    mask = selected(scene, Criteria(**{name: value}), views)
    assert mask.shape == (count,) and not mask[0] and not mask[-1]
    assert mask.sum() == count - 2 or count == 1 or name in ("seen_by", "floaters")


def test_what_is_missing_is_one_sentence():
    with pytest.raises(SceneError, match="no criterion"):
        chosen()
    for name in OF_VIEWS:
        with pytest.raises(SceneError, match="no views"):
            selected(
                SCENE,
                Criteria(**{name: "all" if name == "seen_by" else 0.5 if "lowest" in name else (0, 1)}),
                lambda _: [],
            )


# --- floaters


def solid(count: int = 4000, seed: int = 1) -> Scene:
    """A sphere of radius 1, covered with Gaussians."""
    rng = np.random.default_rng(seed)
    means = rng.normal(size=(count, 3))
    means /= np.linalg.norm(means, axis=1, keepdims=True)
    return Scene.of(
        means,
        np.full((count, 3), np.log(0.02)),
        np.tile([1, 0, 0, 0], (count, 1)),
        np.full(count, 3),
        rng.normal(size=(count, 1, 3)),
    )


def with_points(scene: Scene, points: np.ndarray, log_scales: float, logits: float = 3.0) -> Scene:
    """The scene with further round Gaussians at points (P, 3)."""
    p, arrays = len(points), (scene.means, scene.log_scales, scene.quats, scene.opacity_logits, scene.sh)
    more = (
        points,
        np.full((p, 3), log_scales),
        np.tile([1, 0, 0, 0], (p, 1)),
        np.full(p, logits),
        np.zeros((p, 1, 3)),
    )
    return Scene.of(*(np.concatenate(pair) for pair in zip(arrays, more, strict=True)))


def test_lone_gaussians_are_floaters_and_a_rod_is_none():
    rod = np.c_[np.linspace(1, 2.5, 60), np.zeros((60, 2))]  # one Gaussian thick
    floating = np.array([[0, 2.0, 0], [0, 2.01, 0], [0, 0, -1.8], [0.0, 0.0, 0.0]])
    scene = with_points(solid(), np.r_[rod, floating], np.log(0.02))
    assert np.flatnonzero(on_small_islands(scene)).tolist() == list(range(4060, 4064))


def test_a_large_island_and_a_wide_background_are_no_floaters():
    other = solid(400, seed=2).means * 0.3 + [3, 0, 0]
    sky = solid(400, seed=4).means * 40
    assert not on_small_islands(
        with_points(with_points(solid(), other, np.log(0.02)), sky, np.log(3.0))
    ).any()


def test_invisible_gaussians_are_no_floaters_and_no_bridge():
    rod = np.c_[np.linspace(1.05, 2.0, 40), np.zeros((40, 2))]
    scene = with_points(
        with_points(solid(), rod, np.log(0.02), logits=-9.0), np.array([[2.0, 0, 0]]), np.log(0.02)
    )
    assert np.flatnonzero(on_small_islands(scene)).tolist() == [4040] and invisible(scene).sum() == 40


@pytest.mark.parametrize(
    "scene",
    [
        scenes.empty_scene(),
        scenes.random_scene(1),
        scenes.random_scene(31),
        scenes.random_scene(40, spread=0.0),
    ],
)
def test_small_and_degenerate_scenes_have_no_floaters(scene):
    assert not on_small_islands(scene).any()


def ring(count: int) -> list[Camera]:
    """Cameras 4 units from the origin, which look at it."""
    base = scenes.CAMERAS["rotated"]
    found = []
    for angle in np.linspace(0, 2 * np.pi, count, endpoint=False):
        viewmat = np.eye(4)
        viewmat[:3, :3] = [[np.cos(angle), 0, np.sin(angle)], [0, 1, 0], [-np.sin(angle), 0, np.cos(angle)]]
        viewmat[2, 3] = 4
        K = np.array([[100.0, 0, 50], [0, 100.0, 50], [0, 0, 1]])
        found.append(replace(base, viewmat=viewmat, K=K, width=100, height=100))
    return found


def test_haze_hangs_before_cameras_and_thin_things_do_not():
    # towards a camera at (0, 0, 4): as near as the haze
    rod = np.c_[np.zeros((200, 2)), np.linspace(1, 3.2, 200)]
    air = np.array([[0.14, 0.14, 3.0], [3.2, -0.1, 0.05]])
    scene = with_points(with_points(solid(), rod, np.log(0.02)), air, np.log(0.15), logits=-2.0)
    cameras = ring(12)
    mask = haze.hangs_before_cameras(scene, cameras)
    assert mask[-2:].all() and not mask[:-2].any()
    assert not haze.hangs_before_cameras(scene, cameras[: haze.LEAST_VIEWS - 1]).any()
    assert criteria.floaters(scene, cameras)[-2:].all()
