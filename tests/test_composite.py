"""Pictures with opaque surfaces in them, against what they must equal."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import scenes
from svrgs_addon.bench.scenes import orbit_camera, room
from svrgs_addon.camera import Camera
from svrgs_addon.files.images import linear_to_srgb
from svrgs_addon.native import Rasterizer, RenderOptions
from svrgs_addon.render.composite import FAR, composite, composite_while
from svrgs_addon.render.mesh_depth import Surface, Triangles, surface
from svrgs_addon.render.passes import linear_rgba, overlay_rgba

CAMERA = orbit_camera(64, 40)


@pytest.fixture(scope="module")
def scene():
    return room(2000)


def image_of(picture, name: str) -> np.ndarray:
    return picture.rgb if name == "rgb" else picture.images[name]


def plane(z: float, rgb=(0.2, 0.6, 0.9)) -> Surface:
    shape = CAMERA.height, CAMERA.width
    return Surface(np.full(shape, z, np.float32), np.broadcast_to(np.float32(rgb), (*shape, 3)))


def depths(scene) -> np.ndarray:
    return scene.means @ CAMERA.viewmat[2, :3] + CAMERA.viewmat[2, 3]


def test_without_a_surface_it_is_the_rasterizers_picture(scene):
    picture = composite(Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3))
    expected = Rasterizer().forward(scene, CAMERA, RenderOptions(background=(0.1, 0.2, 0.3), mask_kind="svr"), outputs=("rgb", "mask", "hits"))
    for name, image in expected.items():
        np.testing.assert_array_equal(image_of(picture, name), image)


def test_a_flat_surface_hides_what_lies_behind_it(scene):
    z = float(np.median(depths(scene)))
    picture = composite(Rasterizer(), scene, CAMERA, surface=plane(z))
    before = scene.select(depths(scene) <= z)
    expected = Rasterizer().forward(
        before, CAMERA, RenderOptions(background=(0.2, 0.6, 0.9), mask_kind="svr"), outputs=("rgb", "mask", "hits", "alpha", "depth")
    )
    for name in ("rgb", "alpha", "mask", "hits"):
        np.testing.assert_allclose(image_of(picture, name), expected[name], atol=2e-5, rtol=1e-5)
    np.testing.assert_allclose(picture.depth, expected["depth"] + (1 - expected["alpha"]) * z, rtol=1e-5)
    assert (picture.coverage == 1).all()


def test_a_slope_hides_at_every_pixel_what_lies_behind_it_there(scene):
    slope = plane(0)
    slope.depth[:] = np.linspace(depths(scene).min() - 1, depths(scene).max() + 1, CAMERA.width)
    slope.depth[:, 48:] = np.inf
    picture, whole = composite(Rasterizer(), scene, CAMERA, surface=slope), composite(Rasterizer(), scene, CAMERA)
    for name in ("rgb", "alpha", "mask", "hits", "depth"):
        np.testing.assert_array_equal(image_of(picture, name)[:, 48:], image_of(whole, name)[:, 48:])
    assert (picture.images["hits"][:, 0] == 0).all() and (picture.coverage[:, :48] == 1).all()
    for column in (12, 25, 40):
        flat = composite(Rasterizer(), scene, CAMERA, surface=plane(slope.depth[0, column]))
        for name in ("rgb", "alpha", "mask", "hits", "depth"):
            np.testing.assert_array_equal(image_of(picture, name)[:, column], image_of(flat, name)[:, column])


def test_nothing_at_all_is_far_away():
    picture = composite(Rasterizer(), scenes.empty_scene(), CAMERA)
    assert (picture.depth == FAR).all() and not picture.coverage.any()


def test_a_drawing_nobody_wants_any_more_stops(scene):
    assert composite_while(lambda: False, Rasterizer(), room(300_000), orbit_camera(1920, 1080)) is None
    assert composite_while(lambda: True, Rasterizer(), scene, CAMERA) is not None


def test_errors_of_a_drawing_come_through():
    with pytest.raises(AttributeError):
        composite_while(lambda: True, Rasterizer(), None, CAMERA)


def test_the_film_encodes_back_to_the_drawing(scene):
    picture = composite(Rasterizer(), scene, CAMERA)
    opaque, clear = linear_rgba(picture, False), linear_rgba(picture, True)
    np.testing.assert_allclose(linear_to_srgb(opaque[..., :3]), picture.rgb, atol=1e-6)
    assert (opaque[..., 3] == 1).all()
    straight = clear[..., :3] / np.maximum(clear[..., 3:], 1e-9)
    np.testing.assert_allclose(linear_to_srgb(straight) * clear[..., 3:], picture.rgb, atol=1e-5)


def test_another_working_space_holds_the_same_colours(scene):
    picture, swapped = composite(Rasterizer(), scene, CAMERA), ((0, 1, 0), (1, 0, 0), (0, 0, 1))
    np.testing.assert_array_equal(linear_rgba(picture, False, swapped)[..., [1, 0, 2, 3]], linear_rgba(picture, False))


def test_laid_over_a_picture_it_shows_what_is_before_it(scene):
    hidden = plane(float(np.median(depths(scene)))).depth
    rgba, picture = overlay_rgba(Rasterizer(), scene, CAMERA, hidden), composite(Rasterizer(), scene, CAMERA, surface=plane(hidden[0, 0], (1, 1, 1)))
    np.testing.assert_allclose(rgba[..., :3] + (1 - rgba[..., 3:]), picture.rgb, atol=1e-6)


# --- surfaces


def wall(*corners) -> Triangles:
    return Triangles(np.array([corners], float), np.array([[0.2, 0.4, 0.6]]))


SIMPLE = Camera(np.eye(4), np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]]), 64, 40)


PARALLEL = replace(SIMPLE, K=np.array([[12.0, 0, 32], [0, 12, 20], [0, 0, 1]]), orthographic=True)


def covered_by_rays(triangle: np.ndarray, camera: Camera) -> np.ndarray:
    """(H, W) depth where the ray of a pixel meets the triangle, by solving for it; infinite elsewhere. Camera at the origin."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    plane = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T
    start, rays = (plane - (0, 0, 1), np.array([[[0.0, 0, 1]]])) if camera.orthographic else (np.zeros_like(plane), plane)
    a, b, c = triangle
    system = np.stack(np.broadcast_arrays((a - b)[None, None], (a - c)[None, None], rays, plane)[:3], axis=-1)
    u, v, t = np.moveaxis(np.linalg.solve(system, (a - start)[..., None])[..., 0], -1, 0)
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf)


@pytest.mark.parametrize("camera", [SIMPLE, PARALLEL], ids=["perspective", "orthographic"])
@pytest.mark.parametrize("seed", range(8))
def test_triangles_cover_the_pixels_whose_rays_meet_them(seed, camera):
    """Some reach behind the camera. Rays that graze an edge may fall on either side of it."""
    rng = np.random.default_rng(seed)
    corners = rng.uniform((-3, -2, -1), (3, 2, 6), (3, 3))
    seen, expected = surface(wall(*corners), camera), covered_by_rays(corners, camera)
    both = np.isfinite(expected) & np.isfinite(seen.depth)
    np.testing.assert_allclose(seen.depth[both], expected[both], rtol=1e-4)
    assert (np.isfinite(expected) ^ np.isfinite(seen.depth))[expected > 0.01].sum() <= 2
    assert (seen.rgb[~np.isfinite(seen.depth)] == 0).all()


def test_neighbours_leave_no_gap_and_the_nearer_one_wins():
    a, b, c, d = (-9, -9, 5), (9, -9, 5), (9, 9, 5), (-9, 9, 5)
    back = Triangles(np.array([[a, b, c], [a, c, d]], float), np.full((2, 3), 0.5))
    assert np.isfinite(surface(back, SIMPLE).depth).all()
    front = np.array([[(-1, -1, 2), (1, -1, 2), (0, 1, 2)]], float)
    both = Triangles(np.concatenate([front, back.corners]), np.array([[1, 0, 0], [0.5] * 3, [0.5] * 3]))
    seen = surface(both, SIMPLE)
    np.testing.assert_array_equal(seen.rgb[:, :, 0] == 1, np.isfinite(surface(Triangles(front, np.ones((1, 3))), SIMPLE).depth))


def test_a_scene_behind_the_camera_or_not_finite_is_not_seen():
    for corners in ([(-1, -1, -2), (1, -1, -2), (0, 1, -2)], [(np.nan, 0, 2), (1, 0, 2), (0, 1, 2)]):
        assert all(np.isinf(surface(wall(*corners), camera).depth).all() for camera in (SIMPLE, PARALLEL))
    assert np.isinf(surface(Triangles(np.empty((0, 3, 3)), np.empty((0, 3))), SIMPLE).depth).all()
