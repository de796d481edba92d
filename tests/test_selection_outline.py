"""Gaussians inside an outline that is drawn over a view."""

from __future__ import annotations

import time
from dataclasses import replace

import numpy as np
import pytest

from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.selection.outline import SHOWN, RenderedView, _thread, brush, centres_in, polygon
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.affine import scaled
from svrgs_bench.scenes import orbit_camera, room

WIDTH, HEIGHT = 61, 47


def winding(points: np.ndarray, x: float, y: float) -> bool:
    """Whether a ray to the right crosses the polygon an odd number of times."""
    odd = False
    for (x0, y0), (x1, y1) in zip(points, np.roll(points, -1, axis=0), strict=True):
        if (y0 > y) != (y1 > y):
            odd ^= x < x0 + (y - y0) * (x1 - x0) / (y1 - y0)
    return odd


@pytest.mark.parametrize("corners", [3, 4, 9, 40])
def test_a_polygon_holds_the_pixels_whose_centres_are_inside(corners):
    """Also where it crosses itself, and leaves the picture."""
    points = np.random.default_rng(corners).uniform((-20, -20), (WIDTH + 20, HEIGHT + 20), (corners, 2))
    found = polygon(points, WIDTH, HEIGHT)
    expected = [[winding(points, x + 0.5, y + 0.5) for x in range(WIDTH)] for y in range(HEIGHT)]
    np.testing.assert_array_equal(found, expected)


@pytest.mark.parametrize("length", [1, 2, 7])
def test_a_brush_holds_the_pixels_near_its_path(length):
    rng = np.random.default_rng(length)
    path, radius = rng.uniform((-10, -10), (WIDTH + 10, HEIGHT + 10), (length, 2)), 6.5
    places = np.stack(np.meshgrid(np.arange(WIDTH) + 0.5, np.arange(HEIGHT) + 0.5), axis=-1)
    line = np.concatenate(
        [
            a + np.linspace(0, 1, 2000)[:, None] * (b - a)
            for a, b in zip(path, [*path[1:], path[-1]], strict=True)
        ]
    )
    away = np.array([[np.hypot(*(line - place).T).min() for place in row] for row in places])
    found = brush(path, radius, WIDTH, HEIGHT)
    clear = np.abs(away - radius) > 0.05  # of the points of the line
    np.testing.assert_array_equal(found[clear], (away <= radius)[clear])


@pytest.mark.parametrize("orthographic", [False, True])
def test_what_is_in_the_outline_is_selected_and_what_is_hidden_is_not_shown(orthographic):
    scene, camera = room(2_000), orbit_camera(WIDTH, HEIGHT)
    if orthographic:
        K = np.diag([8.0, 8.0, 1.0])
        K[:2, 2] = camera.K[:2, 2]
        camera = replace(camera, K=K, orthographic=True)
    inside = polygon(np.array([(10.0, 5.0), (50.0, 5.0), (50.0, 40.0), (10.0, 40.0)]), WIDTH, HEIGHT)
    centres = centres_in(scene.means, camera, inside)
    local = scene.means.astype(np.float64) @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
    x, y = camera.pixels(local).T
    expected = (local[:, 2] > 0.2) & (x > 10) & (x < 50) & (y > 5) & (y < 40)
    assert 0 < centres.sum() < scene.count and (centres != expected).sum() <= 2
    small = replace(camera.moved(np.diag([100.0, 100.0, 100.0, 1.0])), unit=0.01)
    assert (centres_in(scaled(scene, 0.01).means, small, inside) != centres).sum() <= 2
    turned = np.eye(4)  # stretched, and far from the origin
    turned[:3] = np.random.default_rng(0).normal(size=(3, 4)) * (1, 1, 1, 1000)
    stored = (scene.means - turned[:3, 3]) @ np.linalg.inv(turned[:3, :3]).T
    moved = centres_in(stored, camera, inside, turned)
    assert (moved != expected).sum() <= 2
    shown, options = RenderedView(scene, camera).shown_in(inside), render_options(scene)
    assert 0 < shown.sum() < scene.count
    rasterizer, peaks = Rasterizer(), np.zeros(scene.count)
    for row, column in np.argwhere(inside):  # the largest alpha T in a pixel, one pixel at a time
        one = np.zeros_like(inside)
        one[row, column] = True
        rasterizer.forward(scene, camera.masked(one), options)
        sums = np.zeros(scene.count)
        rasterizer.add_scores(sums)
        np.maximum(peaks, sums, out=peaks)
    np.testing.assert_array_equal(shown, peaks >= SHOWN)


def test_a_flat_splat_is_selected_where_it_is_seen():
    scene, camera = room(2_000), orbit_camera(WIDTH, HEIGHT)
    inside = np.ones((HEIGHT, WIDTH), bool)
    inside[:, WIDTH // 2 :] = False
    flat = np.diag([1.0, 1.0, 0.0, 1.0])
    flat[2, 3] = 0.5
    seen = centres_in(scene.means, camera, inside, flat)
    placed = (scene.means * (1, 1, 0) + (0, 0, 0.5)).astype(np.float32)
    expected = centres_in(placed, camera, inside)
    assert 0 < expected.sum() < scene.count and (seen != expected).sum() <= 2


def test_an_empty_outline_holds_nothing():
    scene, camera = room(100), orbit_camera(WIDTH, HEIGHT)
    nothing = polygon(np.array([(5.0, 5.0), (5.0, 5.0)]), WIDTH, HEIGHT)
    assert not nothing.any()
    assert not centres_in(scene.means, camera, nothing).any()
    assert not RenderedView(scene, camera).shown_in(nothing).any()


def test_views_that_are_rendered_stopped_or_replaced_show_the_same():
    scene, camera = room(2_000), orbit_camera(WIDTH, HEIGHT)
    left, everything = np.zeros((HEIGHT, WIDTH), bool), np.ones((HEIGHT, WIDTH), bool)
    left[:, : WIDTH // 2] = True
    shown = RenderedView(scene, camera).shown_in(left)
    done, waiting = RenderedView(scene, camera), RenderedView(scene, camera)
    done.begin()
    done._begun.result()
    np.testing.assert_array_equal(done.shown_in(left), shown)
    assert 0 < shown.sum() < done.shown_in(everything).sum()
    _thread().submit(time.sleep, 0.2)
    waiting.begin()
    np.testing.assert_array_equal(waiting.shown_in(left), shown)
    other = RenderedView(scene.select(np.arange(0, 2_000, 3)), camera)
    other.begin()
    assert 0 < other.shown_in(left).sum() and len(other.shown_in(left)) == 667
    np.testing.assert_array_equal(done.shown_in(left), shown)
