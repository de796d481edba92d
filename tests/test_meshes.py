"""Triangles as a camera sees them, against rays in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from plain_triangles import plain_triangles
from svrgs_addon.files.images import linear_to_srgb, srgb_to_linear
from svrgs_addon.native import library
from svrgs_addon.render.meshes import AMBIENT, LIGHT, Surface, Triangles, surface
from svrgs_addon.render.textures import LARGEST, texture
from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import NativeError

SIMPLE = Camera(np.eye(4), np.array([[50.0, 0, 32], [0, 50, 20], [0, 0, 1]]), 64, 40)
PARALLEL = replace(SIMPLE, K=np.array([[12.0, 0, 32], [0, 12, 20], [0, 0, 1]]), orthographic=True)
CAMERAS = pytest.mark.parametrize("camera", [SIMPLE, PARALLEL], ids=["perspective", "orthographic"])
SAMPLES = np.array([(1, -3), (-1, 3), (5, 1), (-3, -5), (-5, 5), (-7, -1), (3, 7), (7, -7)]) / 16
GREY = (0.5, 0.5, 0.5)


def triangles(*corners, color=GREY, **options) -> Triangles:
    return plain_triangles(np.array(corners, float), np.array([color] * len(corners)), **options)


def rays(camera: Camera, offset) -> tuple[np.ndarray, np.ndarray]:
    """Origins and directions (H, W, 3) of the rays of all pixels at an offset from their centres; direction z
    is 1."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    plane = np.stack([x + offset[0], y + offset[1], np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T
    along = np.broadcast_to([0.0, 0, 1], plane.shape)
    return (plane - along, along) if camera.orthographic else (np.zeros_like(plane), plane)


def hit(corners: np.ndarray, camera: Camera, offset=(0.0, 0.0)) -> tuple[np.ndarray, np.ndarray]:
    """(H, W) depth at which the rays meet a triangle, infinite elsewhere, and shares (H, W, 3) of its
    corners."""
    start, along = rays(camera, offset)
    a, b, c = corners
    system = np.stack(
        np.broadcast_arrays((a - b)[None, None], (a - c)[None, None], along, start)[:3], axis=-1
    )
    u, v, t = np.moveaxis(np.linalg.solve(system, (a - start)[..., None])[..., 0], -1, 0)
    return np.where((u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0), t, np.inf), np.stack([1 - u - v, u, v], -1)


def coverage(seen: Surface | None) -> np.ndarray:
    """(H, W) share of each pixel that some triangle covers."""
    if seen is None:
        return np.zeros((SIMPLE.height, SIMPLE.width))
    if seen.rest is None:
        return np.isfinite(seen.depth).astype(float)
    return seen.share * np.isfinite(seen.depth) + (1 - seen.share) * np.isfinite(seen.rest.depth)


@CAMERAS
@pytest.mark.parametrize("seed", range(8))
def test_a_triangle_covers_the_samples_whose_rays_meet_it(seed, camera):
    """Some reach behind the camera. Depths are the mean of the samples that it covers."""
    corners = np.random.default_rng(seed).uniform((-3, -2, -1), (3, 2, 6), (3, 3))
    seen = surface(triangles(*[corners]), camera)
    depths = np.stack([hit(corners, camera, offset)[0] for offset in SAMPLES])
    met = np.isfinite(depths)
    differs = np.abs(coverage(seen) - met.mean(axis=0))
    assert (differs > 1e-6).sum() <= 2 and differs.max() <= 1 / 8, "a ray may graze an edge"
    if seen is not None:
        inner, outer = met.all(axis=0), ~met.any(axis=0)
        np.testing.assert_allclose(seen.depth[inner], depths.mean(axis=0)[inner], rtol=1e-5)
        assert not seen.rgba[outer].any() and np.isinf(seen.depth[outer]).all()


@CAMERAS
def test_neighbours_share_every_sample_exactly(camera):
    """Thin triangles around a point, many of them smaller than a pixel, and others that reach behind the
    camera."""
    rng = np.random.default_rng(3)
    angles = np.sort(rng.uniform(0, 2 * np.pi, 200))
    rim = np.stack([90 * np.cos(angles), 90 * np.sin(angles), rng.uniform(-20, 60, 200)], 1)
    fan = np.array([[(0.3, 0.2, 5), rim[k - 1], rim[k]] for k in range(200)])
    assert (coverage(surface(plain_triangles(fan, np.full((200, 3), 0.5)), camera)) == 1).all()
    flat = fan.copy()
    flat[:, :, 2] = 5
    one_by_one = sum(
        coverage(surface(plain_triangles(one[None], np.full((1, 3), 0.5)), camera)) for one in flat
    )
    np.testing.assert_array_equal(one_by_one, 1)


@CAMERAS
def test_a_pixel_at_an_edge_has_both_surfaces(camera):
    """A triangle before a wall, in another colour; at its edges both, and their mean as if drawn at a hundred
    times the size."""
    front = np.array([(-1.1, -0.9, 2), (1.2, -0.4, 2.2), (0.1, 0.8, 1.9)])
    back = np.array([(-99, -99, 5), (99, -99, 5), (0, 199, 5.0)])
    seen = surface(plain_triangles(np.stack([front, back]), np.array([(1, 0, 0), (0, 0, 1)])), camera)
    exact = np.mean(
        [
            np.isfinite(hit(front, camera, (x, y))[0])
            for x in np.arange(-4.5, 5) / 10
            for y in np.arange(-4.5, 5) / 10
        ],
        axis=0,
    )
    red = seen.share * (seen.rgba[..., 0] > 0) + (1 - seen.share) * (seen.rest.rgba[..., 0] > 0)
    assert np.abs(red - exact).max() < 0.2 and np.abs(red - exact).mean() < 0.003
    edge = seen.share < 1
    assert 20 < edge.sum() < 200 and (seen.depth[edge] < 2.5).all()
    np.testing.assert_allclose(seen.rest.depth[edge], 5, rtol=1e-6)
    assert (seen.rest.rgba[edge][:, 2] > 0).all() and np.isinf(seen.rest.depth[~edge]).all()


def test_colours_of_corners_are_interpolated_in_perspective():
    corners = np.array([(-3.0, -2, 2), (4, -1, 9), (-1, 3, 4)])
    colors = np.random.default_rng(0).uniform(0.1, 1, (1, 3, 3)).astype(np.float32)
    flat = replace(triangles(corners), colors=colors, normals=np.zeros((1, 3, 3), np.float32))
    seen, (depth, shares) = surface(flat, SIMPLE), hit(corners, SIMPLE)
    inner = (coverage(seen) == 1) & np.isfinite(depth)
    expected = linear_to_srgb(AMBIENT * shares @ colors[0].astype(float))
    np.testing.assert_allclose(seen.rgba[inner][:, :3], expected[inner], atol=2e-3)


def test_light_follows_interpolated_normals_and_turns_with_the_side_that_is_seen():
    corners, up = np.array([(-9.0, -9, 4), (9, -9, 4), (0, 15, 4)]), LIGHT / np.linalg.norm(LIGHT)
    normals = np.stack([up, -up, up])[None].astype(np.float32)
    facing = corners[[0, 2, 1]]  # (b - a) x (c - a) points to the camera
    for order, sign in ((facing, 1), (corners, -1)):
        seen, (_, shares) = surface(replace(triangles(order), normals=normals), SIMPLE), hit(order, SIMPLE)
        brightness = AMBIENT + sign * np.linalg.norm(LIGHT) * shares @ (1, -1, 1)
        np.testing.assert_allclose(seen.rgba[..., 0], linear_to_srgb(0.5 * brightness), atol=2e-3)


def test_a_mesh_of_tiny_triangles_has_their_mean_colour():
    """Hundreds per pixel, black and white at random."""
    rng, n = np.random.default_rng(0), 150
    x, y = np.meshgrid(np.linspace(-0.2, 0.2, n + 1), np.linspace(-0.2, 0.2, n + 1))
    points = np.stack([x, y, np.full_like(x, 5)], -1)
    a, b, c, d = points[:-1, :-1], points[:-1, 1:], points[1:, 1:], points[1:, :-1]
    corners = np.concatenate(
        [np.stack([a, b, c], 2).reshape(-1, 3, 3), np.stack([a, c, d], 2).reshape(-1, 3, 3)]
    )
    white = rng.random(len(corners)) < 0.5
    mesh = replace(
        plain_triangles(corners, np.repeat(white[:, None], 3, 1)), normals=np.zeros_like(corners, np.float32)
    )
    seen = surface(mesh, SIMPLE)
    inner = coverage(seen) == 1
    assert inner.sum() >= 9
    # 8 samples; one alone is wrong by 0.5
    assert np.abs(srgb_to_linear(seen.rgba[inner][:, 0]) / AMBIENT - 0.5).mean() < 0.2


def test_holdouts_have_no_colour_and_hide():
    hole, wall = [(-1, -1, 2), (1, -1, 2), (0, 1, 2)], [(-99, -99, 5), (99, -99, 5), (0, 199, 5)]
    both = triangles(hole, wall)
    seen = surface(replace(both, holdout=np.array([True, False])), SIMPLE)
    covered = coverage(surface(triangles(hole), SIMPLE))
    np.testing.assert_allclose(seen.holes, covered, atol=1e-6)
    assert not seen.rgba[covered == 1].any() and (seen.depth[covered == 1] == 2).all()


def test_what_is_behind_the_camera_or_not_finite_is_not_seen():
    for corners in (
        [(-1, -1, -2), (1, -1, -2), (0, 1, -2)],
        [(np.nan, 0, 2), (1, 0, 2), (0, 1, 2)],
        [(1, 1, 2)] * 3,
    ):
        assert all(surface(triangles(corners), camera) is None for camera in (SIMPLE, PARALLEL))
    assert surface(plain_triangles(np.empty((0, 3, 3)), np.empty((0, 3))), SIMPLE) is None
    wild = np.random.default_rng(0).normal(0, 1, (300, 3, 3)) * 10.0 ** np.random.default_rng(1).integers(
        -30, 30, (300, 1, 1)
    )
    seen = surface(plain_triangles(wild, np.full((300, 3), 0.5)), SIMPLE)
    assert np.isfinite(seen.rgba).all() and not np.isnan(seen.depth).any()


def test_pictures_do_not_depend_on_the_number_of_threads():
    rng = np.random.default_rng(5)
    mesh = plain_triangles(
        rng.uniform((-3, -2, 1), (3, 2, 6), (300, 1, 3)) + rng.normal(0, 0.3, (300, 3, 3)),
        rng.random((300, 3)),
    )
    camera = replace(SIMPLE, width=640, height=400, K=np.diag([10, 10, 1]) @ SIMPLE.K)
    before, found = library.threads(), []
    try:
        for threads in (1, 2, 5):
            library.set_threads(threads)
            found.append(surface(mesh, camera))
    finally:
        library.set_threads(before)
    for other in found[1:]:
        for name in ("depth", "rgba", "share"):
            np.testing.assert_array_equal(getattr(other, name), getattr(found[0], name))


# --- textures


def square(pixels: np.ndarray, uv: np.ndarray, z=4.0, repeat=True) -> Triangles:
    """A square before the camera, without light and shade, with texture coordinates (4, 2)."""
    # from the lower left, counter-clockwise
    a, b, c, d = np.array([(-2.0, 1, z), (2, 1, z), (2, -1, z), (-2, -1, z)])
    made = triangles([a, b, c], [a, c, d], color=(1 / AMBIENT,) * 3)
    uvs = np.stack([uv[[0, 1, 2]], uv[[0, 2, 3]]]).astype(np.float32)
    return replace(
        made,
        normals=np.zeros((2, 3, 3), np.float32),
        uvs=uvs,
        texture=np.zeros(2, np.int32),
        textures=(texture(pixels, repeat),),
    )


CORNERS = np.array([(0, 0), (1, 0), (1, 1), (0, 1)], float)


def test_a_texture_lies_upright_and_smooth():
    """4 x 2 texels of 13 x 13 pixels: their colours at their centres, and means of linear colours between
    them."""
    pixels = np.random.default_rng(0).integers(0, 256, (2, 4, 3)).astype(np.uint8)
    seen = surface(
        square(pixels, CORNERS), replace(SIMPLE, K=np.array([[52.0, 0, 32], [0, 52, 20], [0, 0, 1]]))
    ).rgba[..., :3]
    np.testing.assert_allclose(seen[[[26], [13]], 6 + 6 + 13 * np.arange(4)], pixels / 255, atol=1e-4)
    between = srgb_to_linear(seen[26, [31, 32]]).mean(axis=0)
    np.testing.assert_allclose(
        between, srgb_to_linear(pixels[0, 1:3] / np.float32(255)).mean(axis=0), atol=1e-4
    )


@pytest.mark.parametrize("tilt", [0.0, 1.3])
def test_a_far_texture_shows_the_mean_of_its_texels(tilt):
    """A fine checkerboard of half black: each pixel is near the mean of its many texels, also on a floor seen
    at a low angle."""
    fine = np.indices((512, 512)).sum(axis=0) % 2 * np.uint8(255)
    made = square(np.repeat(fine[..., None], 3, 2), CORNERS * 4)
    turn = np.array([[1, 0, 0], [0, np.cos(tilt), -np.sin(tilt)], [0, np.sin(tilt), np.cos(tilt)]])
    made = replace(
        made, corners=np.ascontiguousarray((made.corners - (0, 0, 4)) @ turn.T + (0, 0, 4), np.float32)
    )
    seen = surface(made, SIMPLE)
    inner = coverage(seen) == 1
    linear = srgb_to_linear(seen.rgba[inner][:, :3])
    assert inner.sum() > 100 and np.abs(linear - 0.5).max() < 0.02


def test_a_floor_seen_at_a_low_angle_stays_sharp_across():
    """Stripes along the view: 16 texels wide each, and squeezed together along it."""
    stripes = np.repeat((np.arange(256) // 16 % 2 * 255).astype(np.uint8)[None, :, None], 256, 0)
    made = square(np.repeat(stripes, 3, 2), CORNERS)
    turn = np.array([[1, 0, 0], [0, np.cos(1.4), -np.sin(1.4)], [0, np.sin(1.4), np.cos(1.4)]])
    made = replace(
        made, corners=np.ascontiguousarray((made.corners - (0, 0, 4)) @ turn.T + (0, 0, 4), np.float32)
    )
    seen = surface(made, replace(SIMPLE, width=256, height=160, K=np.diag([4, 4, 1]) @ SIMPLE.K))
    inner = (seen.share == 1) & np.isfinite(seen.depth)
    row = np.flatnonzero(inner.sum(axis=1) > 150)[0]
    values = seen.rgba[row][inner[row], 0]
    assert ((values < 0.2) | (values > 0.8)).mean() > 0.6


def test_outside_its_borders_a_texture_repeats_or_goes_on():
    pixels = np.zeros((8, 8, 3), np.uint8)
    pixels[:, :4] = 255
    for repeat, expected in ((True, [1, 0, 1, 0, 1, 0]), (False, [1, 1, 1, 0, 0, 0])):
        seen = surface(square(pixels, CORNERS * (3, 1) - (1, 0), repeat=repeat), SIMPLE).rgba
        assert [round(float(seen[20, int(32 - 25 + 50 * (k + 0.5) / 6), 0])) for k in range(6)] == expected


def test_levels_are_linear_means_and_large_pictures_are_reduced():
    odd = texture(np.array([[[0, 0, 0], [255, 255, 255], [0, 0, 0]]], np.uint8))
    assert (odd.width, odd.height, len(odd.texels)) == (3, 1, 3 + 2 + 1)
    half = round(255 * float(linear_to_srgb(np.float32(0.5))))
    np.testing.assert_array_equal(
        odd.texels[3:, 0], [half, 0, round(255 * float(linear_to_srgb(np.float32(0.25))))]
    )
    large = texture(np.full((3, LARGEST * 2, 3), 100, np.uint8))
    assert (large.width, large.height) == (LARGEST, 2) and (large.texels == 100).all()
    assert texture(np.full((1, 1, 3), 0.5, np.float32)).texels.tolist() == [[128] * 3]


# --- arguments


def test_wrong_triangles_are_refused():
    good = square(np.zeros((2, 2, 3), np.uint8), CORNERS)
    for change in (
        {"normals": good.normals[:1]}, {"uvs": good.uvs[..., :1]}, {"texture": good.texture.astype(np.int64)},
        {"holdout": good.holdout[:1]},
        {"corners": good.corners.astype(float)}, {"colors": good.colors[:, ::-1]},
        {"textures": (replace(good.textures[0], texels=good.textures[0].texels[1:]),)},
    ):  # fmt: skip
        with pytest.raises((TypeError, ValueError)):
            surface(replace(good, **change), SIMPLE)
    for number in (1, -2):
        with pytest.raises(NativeError, match="texture"):
            surface(replace(good, texture=np.full(2, number, np.int32)), SIMPLE)
    with pytest.raises(NativeError, match="1 to 32768"):
        surface(good, replace(SIMPLE, width=0))
