"""Equirectangular panoramas: their views, against known pictures of all directions, and against narrow
perspective views in float64."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from native_helpers import typed
from plain_triangles import plain_triangles
from svrgs_addon.native.pictures import add_view
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render.composite import FAR, Composite, composite, split
from svrgs_addon.render.meshes import surface
from svrgs_addon.render.panorama import (
    CELL,
    Panorama,
    Patch,
    composite_panorama,
    composite_view,
    directions,
    patches,
)
from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import Cancelled, NativeError
from svrgs_bench.scenes import room

FULL = Panorama(np.eye(4), 160, 80)
PART = Panorama(np.eye(4), 70, 90, (-0.4, 1.9), (-0.2, 1.5))
MIRRORED = replace(PART, longitude=(1.0, -2.0))
TINY = Panorama(np.eye(4), 1, 1, (0.1, 0.2), (0.3, 0.35))
BEYOND = replace(FULL, longitude=(-1.5 * np.pi, 1.5 * np.pi), width=240)
PANORAMAS = pytest.mark.parametrize(
    "panorama", [FULL, PART, MIRRORED, TINY, BEYOND], ids=["full", "part", "mirrored", "tiny", "beyond"]
)
TURN = np.linalg.qr(np.random.default_rng(0).normal(size=(3, 3)))[0]


def all_directions(panorama: Panorama) -> np.ndarray:
    """(H, W, 3) unit directions in the panorama's frame."""
    return directions(panorama.latitudes[:, None], panorama.longitudes)


def image_of(camera: Camera, function) -> np.ndarray:
    """A function of unit directions (..., 3) in the world, at the pixels of a camera."""
    y, x = np.mgrid[: camera.height, : camera.width] + 0.5
    rays = np.stack([x, y, np.ones_like(x)], -1) @ np.linalg.inv(camera.K).T @ camera.viewmat[:3, :3]
    return function(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def waves(d: np.ndarray) -> np.ndarray:
    return 0.5 + 0.2 * np.sin(5 * d + d[..., [1, 2, 0]]) + 0.2 * d[..., [2, 0, 1]]


def analytic(camera: Camera) -> Composite:
    """A picture of waves on a sphere of radius 3, half transparent where x < 0, and nothing at all where x <
    -0.5."""
    rgb = image_of(camera, waves).astype(np.float32)
    x = image_of(camera, lambda d: d[..., 0])
    coverage = np.where(x < -0.5, 0, np.where(x < 0, 0.5, 1)).astype(np.float32)
    y, column = np.mgrid[: camera.height, : camera.width] + 0.5
    z = 3 / np.linalg.norm(np.stack([column, y, np.ones_like(y)], -1) @ np.linalg.inv(camera.K).T, axis=-1)
    images = {
        "depth": np.where(coverage > 0, z, FAR).astype(np.float32),
        "alpha": coverage,
        "mask": rgb[..., 0],
        "hits": 10 * rgb[..., 1],
    }
    return Composite(
        rgb, coverage, (1 - coverage) / 2, images, np.concatenate([rgb[..., ::-1], coverage[..., None]], 2)
    )


def share(patch: Patch) -> np.ndarray:
    return patch.row_weights[:, None] * patch.column_weights


@PANORAMAS
def test_the_shares_of_all_views_have_the_sum_1(panorama):
    np.testing.assert_allclose(sum(map(share, patches(panorama))), 1, atol=1e-12)


def test_views_of_a_band_are_at_most_a_cell_apart():
    pixel = 2 * np.pi / FULL.width
    for patch in (patch for patch in patches(FULL) if not patch.column_weights.all()):
        level = np.cos(FULL.latitudes[patch.row_weights >= 0.5]).max()
        assert (patch.column_weights > 0).sum() * pixel * level <= 2 * CELL + pixel


@PANORAMAS
def test_a_view_sees_all_of_its_pixels_near_its_middle(panorama):
    """With room around them for cubic interpolation."""
    for patch in patches(panorama):
        rays = all_directions(panorama)[share(patch) > 0] @ patch.turn.T
        assert (rays[:, 2] > np.cos(np.radians(45))).all()
        x, y = patch.camera.pixels(rays).T
        assert min(x.min(), y.min()) >= 2 and x.max() <= patch.camera.width - 2
        assert y.max() <= patch.camera.height - 2
        np.testing.assert_allclose(patch.turn @ panorama.viewmat[:3, :3], patch.camera.viewmat[:3, :3])


@PANORAMAS
def test_a_picture_of_all_directions_is_found_again(panorama):
    turned = replace(panorama, viewmat=np.block([[TURN, np.zeros((3, 1))], [0, 0, 0, 1]]))
    picture, expected = composite_panorama(analytic, turned), waves(all_directions(turned) @ TURN)
    assert picture.rgb.shape == (panorama.height, panorama.width, 3)
    for found, known in (
        (picture.rgb, expected),
        (picture.images["mask"], expected[..., 0]),
        (picture.images["hits"] / 10, expected[..., 1]),
    ):
        np.testing.assert_allclose(found, known, atol=2e-3)
    np.testing.assert_allclose(picture.behind[..., :3], expected[..., ::-1], atol=2e-3)
    assert all((image >= 0).all() for image in picture.images.values())
    assert all(0 <= image.min() <= image.max() <= 1 for image in (picture.coverage, picture.holes))
    x = (all_directions(turned) @ TURN)[..., 0]
    for low, high, coverage in ((0.1, 2, 1), (-0.4, -0.1, 0.5), (-2, -0.6, 0)):
        inside = (x > low) & (x < high)
        np.testing.assert_allclose(picture.coverage[inside], coverage, atol=1e-3)
        np.testing.assert_allclose(picture.holes[inside], (1 - coverage) / 2, atol=1e-3)
        np.testing.assert_allclose(picture.depth[inside], 3 if coverage else FAR, rtol=1e-3)


@pytest.mark.slow
def test_pixels_are_those_of_perspective_views_in_their_direction():
    """Each pixel against the middle of a view of 50 degrees in float64; in levels of 255."""
    scene, r64, rng = room(60_000), Rasterizer("float64"), np.random.default_rng(0)
    viewmat = np.eye(4)
    viewmat[:3, :3], viewmat[:3, 3] = TURN, (0.3, 0.2, 0.5)
    panorama = Panorama(viewmat, 1024, 512)
    picture = composite_panorama(lambda camera: composite(Rasterizer(), scene, camera), panorama)
    exact = typed(scene, np.float64)
    rows, columns = rng.integers(0, 512, 80), rng.integers(0, 1024, 80)
    errors = []
    for row, column in zip(rows, columns, strict=True):
        one = replace(
            panorama, width=1, height=1,
            latitude=(panorama.latitudes[row] - 1e-3, panorama.latitudes[row] + 1e-3),
            longitude=(panorama.longitudes[column] - 1e-3, panorama.longitudes[column] + 1e-3),
        )  # fmt: skip
        forward = all_directions(one)[0, 0]
        right = np.cross(forward, (0, -1, 0)) / np.linalg.norm(np.cross(forward, (0, -1, 0)))
        view, n = np.eye(4), 2 * int(np.tan(np.radians(25)) * panorama.focal) + 1
        view[:3] = np.stack([right, np.cross(forward, right), forward]) @ viewmat[:3]
        camera = Camera(
            view, np.array([[panorama.focal, 0, n / 2], [0, panorama.focal, n / 2], [0, 0, 1]]), n, n
        )
        expected = r64.forward(exact, camera, RenderOptions(), outputs=("rgb",))["rgb"][n // 2, n // 2]
        errors.append(255 * np.abs(picture.rgb[row, column] - expected).mean())
    assert np.mean(errors) < 2 and np.percentile(errors, 95) < 8, (np.mean(errors), np.percentile(errors, 95))


@pytest.mark.parametrize("axis", [0, 1], ids=["rows", "columns"])
def test_there_are_no_seams(axis):
    """Each pixel is drawn once more with the shares that the views have in the next pixel: less than one
    level of 255.

    A part of a panorama that would be 2048 pixels wide.
    """
    scene, viewmat = room(60_000), np.eye(4)
    viewmat[:3, 3] = 0.3, 0.2, 0.5
    panorama = Panorama(
        viewmat, 400, 400, (0.1, 0.1 + 400 / 2048 * 2 * np.pi), (-0.4, -0.4 + 400 / 2048 * 2 * np.pi)
    )
    sums = np.zeros((2, 400, 400, 4), np.float32)
    for patch in patches(panorama):
        rgb = composite(Rasterizer(), scene, patch.camera).rgb
        image = np.concatenate([rgb, np.ones_like(rgb[..., :1])], axis=2)
        weights = [patch.row_weights, patch.column_weights]
        for moved in (0, 1):
            if moved:
                weights[axis] = np.where(weights[axis] > 0, np.append(weights[axis][1:], 0), 0)
            add_view(
                image,
                patch.turn,
                patch.camera.K,
                -1,
                sums[moved],
                panorama.latitudes,
                panorama.longitudes,
                *weights,
            )
    one, other = (part[..., :3] / np.maximum(part[..., 3:], 1e-6) for part in sums)
    inner = (slice(0, -1), slice(None)) if axis == 0 else (slice(None), slice(0, -1))
    largest = 255 * np.abs(one - other)[inner].max()
    assert 0.05 < largest < 1


def test_meshes_are_cut_to_their_share_and_at_their_distance():
    """The inside of a cube around the camera: its sides are 2 away."""
    corners = np.array([[x, y, z] for x in (-2, 2) for y in (-2, 2) for z in (-2.0, 2)])
    sides = [(0, 1, 3, 2), (4, 6, 7, 5), (0, 4, 5, 1), (2, 3, 7, 6), (0, 2, 6, 4), (1, 5, 7, 3)]
    triangles = np.concatenate([corners[[[a, b, c], [a, c, d]]] for a, b, c, d in sides])
    mesh, empty = plain_triangles(triangles, np.full((12, 3), 0.5)), room(10).select(np.arange(0))
    picture = composite_panorama(
        lambda camera: composite(Rasterizer(), empty, camera, surface=surface(mesh, camera)), FULL
    )
    expected = 2 / np.abs(all_directions(FULL)).max(axis=2)
    np.testing.assert_allclose(picture.depth, expected, rtol=0.02)
    np.testing.assert_allclose(picture.coverage, 1, atol=1e-6)
    assert picture.holes.max() < 1e-6
    apart = composite_panorama(
        lambda camera: split(Rasterizer(), room(500), camera, surface=surface(mesh, camera)), FULL
    )
    assert apart.behind.shape == (80, 160, 4) and apart.behind[..., 3].max() <= 1


def test_a_perspective_view_is_drawn_as_it_is_and_a_stop_comes_through():
    camera = next(patches(FULL)).camera
    np.testing.assert_array_equal(composite_view(analytic, camera).rgb, analytic(camera).rgb)
    rasterizer = Rasterizer()
    rasterizer.cancel[0] = 1
    with pytest.raises(Cancelled):
        composite_view(lambda camera: composite(rasterizer, room(1000), camera), FULL)


def test_wrong_views_are_refused():
    image, sums, rows = np.zeros((5, 6, 2), np.float32), np.zeros((3, 4, 2), np.float32), np.zeros(3)
    columns = np.zeros(4)
    good = {
        "image": image, "turn": np.eye(3), "K": np.eye(3), "along": 1, "sums": sums, "latitudes": rows,
        "longitudes": columns,
        "row_weights": rows, "column_weights": columns,
    }  # fmt: skip
    add_view(**good)
    for change in (
        {"image": image.astype(float)}, {"image": image[:, ::-1]}, {"sums": sums[..., :1]},
        {"sums": sums.astype(float)}, {"latitudes": columns},
        {"column_weights": columns.astype(np.float32)},
    ):  # fmt: skip
        with pytest.raises(TypeError):
            add_view(**good | change)
    with pytest.raises(NativeError, match="1 to 64 channels"):
        add_view(
            **good | {"image": np.zeros((5, 6, 65), np.float32), "sums": np.zeros((3, 4, 65), np.float32)}
        )
