"""Cameras for a splat without photographs: inside and outside told apart, free places, what the views see."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest

from svrgs_addon.native import library
from svrgs_addon.native.library import thresholds
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.scene.concatenate import concatenated
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import SceneError
from svrgs_addon.views.rig import Rig, place_rig, quick_rig
from svrgs_addon.views.rig.around import cameras_around, middle_and_radius
from svrgs_addon.views.rig.place import MAX_CHOSEN, OUTSIDE
from svrgs_addon.views.rig.preview import COLORS, preview


def scene_of(means: np.ndarray, scale: float) -> Scene:
    n = len(means)
    rng = np.random.default_rng(1)
    return Scene.of(
        means,
        np.full((n, 3), np.log(scale)),
        rng.normal(size=(n, 4)),
        np.full(n, 2.0),
        rng.normal(size=(n, 1, 3)),
    )


def solid(count: int = 3_000, radius: float = 2.0, middle=(0.0, 0.0, 0.0)) -> Scene:
    """A ball full of Gaussians."""
    rng = np.random.default_rng(0)
    points = rng.normal(size=(count, 3))
    points *= radius * rng.uniform(size=(count, 1)) ** (1 / 3) / np.linalg.norm(points, axis=1, keepdims=True)
    return scene_of(points + np.array(middle), 0.08 * radius)


def dense() -> Scene:
    """A ball whose Gaussians are opaque and overlap: views see its surface alone."""
    scene = solid()
    return dataclasses.replace(
        scene,
        log_scales=scene.log_scales + np.float32(np.log(1.5)),
        opacity_logits=np.full(scene.count, 5, np.float32),
    )


def room(count: int = 12_000, side: float = 6.0) -> Scene:
    """The six walls of a cube."""
    rng = np.random.default_rng(0)
    points = rng.uniform(-side / 2, side / 2, (count, 3))
    points[np.arange(count), rng.integers(0, 3, count)] = rng.choice([-side / 2, side / 2], count)
    return scene_of(points, 0.02 * side)


def eyes(rig: Rig) -> np.ndarray:
    return np.array([camera.position for camera in (*rig.cameras, *rig.held_out)])


@pytest.mark.parametrize("rig_of", (place_rig, quick_rig))
def test_an_object_is_looked_at_from_outside(rig_of):
    rig = rig_of(solid(), held_out=6)
    assert not rig.inside_out
    assert (np.linalg.norm(eyes(rig), axis=1) > 2.0 + thresholds().near).all()
    assert len(rig.held_out) == 6


def within_the_room(rig: Rig) -> np.ndarray:
    """(P,) bool: cameras inside, and not in a wall."""
    return (np.abs(eyes(rig)) < 3.0 - thresholds().near).all(axis=1)


def test_a_room_is_looked_at_from_inside():
    rig = quick_rig(room(), held_out=6)
    assert rig.inside_out and within_the_room(rig).all()


@pytest.mark.slow
def test_a_room_whose_walls_show_from_outside_is_looked_at_from_there_too():
    rig = place_rig(room(), held_out=8)
    outside = ~within_the_room(rig)
    assert rig.inside_out and outside[: len(rig.cameras)].sum() == OUTSIDE
    assert outside[len(rig.cameras) :].sum() == 2
    assert (np.linalg.norm(eyes(rig)[outside], axis=1) > 3 * 3**0.5).all(), "a camera is in a wall"


@pytest.mark.slow
def test_what_hides_behind_the_walls_of_a_room_is_looked_at_from_inside_alone():
    """A room full of small things, with walls that let nothing through."""
    walls, things = room(), solid(30_000, 1.5)
    walls = dataclasses.replace(
        walls,
        opacity_logits=np.full(walls.count, 6, np.float32),
        log_scales=walls.log_scales + np.float32(np.log(2)),
    )
    scene = concatenated([walls, dataclasses.replace(things, log_scales=things.log_scales - 2)])
    rig = place_rig(scene, held_out=8)
    assert rig.inside_out and within_the_room(rig).all()


@pytest.mark.slow
@pytest.mark.parametrize("scene", (dense(), room()), ids=("object", "room"))
def test_nearly_all_is_seen_by_three_views(scene):
    """As the rig says of itself, and as its pictures show."""
    rig = place_rig(scene)
    assert rig.seen is not None and rig.seen >= 0.995
    counts, rasterizer = np.zeros(scene.count, int), Rasterizer()
    for camera in rig.cameras:
        peaks = np.zeros(scene.count, np.float32)
        rasterizer.forward(scene, camera, RenderOptions(), outputs=())
        rasterizer.add_scores(np.zeros(scene.count), peaks, np.zeros(scene.count, np.int64))
        counts += peaks >= thresholds().alpha_cut
    assert (counts[counts > 0] >= 3).mean() > 0.9


@pytest.mark.slow
def test_a_porous_object_takes_as_many_views_as_there_may_be():
    """Its inner Gaussians are seen through gaps, from few places; the rig says how much it sees."""
    rig = place_rig(solid())
    assert len(rig.cameras) >= MAX_CHOSEN and rig.seen is not None and 0.96 < rig.seen < 0.995


@pytest.mark.slow
def test_a_picture_shows_the_cameras_and_hides_those_behind_the_scene():
    scene = solid()
    rig = place_rig(scene, views=16, held_out=4)
    picture = preview(scene, rig)
    without = preview(scene, dataclasses.replace(rig, held_out=[]))
    blue, orange = (np.array(COLORS[name], np.uint8) for name in ("held_out", "rig"))
    assert (picture == orange).all(axis=2).sum() > 500 and (picture == blue).all(axis=2).sum() > 100
    assert not (without == blue).all(axis=2).any()
    open_space = preview(dataclasses.replace(scene, opacity_logits=np.full(scene.count, -9, np.float32)), rig)
    # the ball hides some
    assert (open_space == orange).all(axis=2).sum() > (picture == orange).all(axis=2).sum()


@pytest.mark.slow
def test_held_out_views_are_not_those_of_the_rig():
    rig = place_rig(solid(), held_out=8)
    own = np.array([camera.position for camera in rig.cameras])
    for camera in rig.held_out:
        assert np.linalg.norm(own - camera.position, axis=1).min() > 0.01
    assert len({camera.name for camera in (*rig.cameras, *rig.held_out)}) == len(rig.cameras) + 8


@pytest.mark.slow
def test_the_same_seed_gives_the_same_rig_on_any_number_of_threads(default_threads):
    rigs = []
    for threads in (1, 3):
        library.set_threads(threads)
        rigs.append(place_rig(solid(1_000), views=32, seed=4))
    assert all(
        (a.viewmat == b.viewmat).all() and (a.K == b.K).all()
        for a, b in zip(rigs[0].cameras, rigs[1].cameras, strict=True)
    )
    assert (place_rig(solid(1_000), views=32, seed=5).cameras[0].viewmat != rigs[0].cameras[0].viewmat).any()


@pytest.mark.parametrize(
    "scene",
    (solid(middle=(1e6, -1e6, 1e6), radius=40.0), solid(1), solid(1_000, radius=1e-3)),
    ids=("far", "one", "tiny"),
)
def test_scenes_of_every_place_and_size(scene):
    rig = quick_rig(scene)
    assert rig.cameras
    assert all(np.isfinite(camera.viewmat).all() and np.isfinite(camera.K).all() for camera in rig.cameras)
    assert 512 <= rig.cameras[0].width == rig.cameras[0].height <= 1024


@pytest.mark.filterwarnings("error")
def test_places_at_the_end_of_all_numbers_are_finite():
    scene = solid()
    scene.means[:3], scene.means[3:5] = 3e38, -3e38
    rig = place_rig(scene, views=4)
    assert all(np.isfinite(camera.viewmat).all() for camera in rig.cameras)


def test_rows_that_are_not_finite_are_left_out():
    scene = solid()
    scene.means[:100] = np.nan
    scene.log_scales[100:110] = np.inf
    assert not quick_rig(scene).inside_out


def test_a_scene_that_shows_nothing_is_refused():
    with pytest.raises(SceneError, match="transparent"):
        quick_rig(dataclasses.replace(solid(), opacity_logits=np.full(3_000, -20, np.float32)))
    with pytest.raises(SceneError, match="finite"):
        quick_rig(dataclasses.replace(solid(), means=np.full((3_000, 3), np.nan, np.float32)))


def test_cameras_around_a_scene_look_at_its_middle():
    scene = solid(middle=(3.0, 4.0, 5.0))
    middle, radius = middle_and_radius(scene)
    assert np.linalg.norm(middle - [3, 4, 5]) < 0.2 and 2 < radius < 5
    for camera in cameras_around(scene, 9, 64):
        local = camera.viewmat[:3, :3] @ middle + camera.viewmat[:3, 3]
        assert local[2] > radius and camera.pixels(local[None])[0] == pytest.approx([32, 32], abs=1e-6)
    up = np.array([camera.viewmat[1, 1] for camera in cameras_around(scene, 9, 64)])
    assert (up > 0).all(), "y points down in every picture"
