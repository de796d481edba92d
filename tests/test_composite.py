"""Pictures with opaque surfaces in them, against what they must equal."""

from __future__ import annotations

import numpy as np
import pytest

import scenes
from svrgs_addon.files.images import linear_to_srgb
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render.composite import (
    FAR,
    ON_CATCHER,
    PASS_OUTPUTS,
    Composite,
    composite,
    composite_while,
    split,
)
from svrgs_addon.render.meshes import Surface
from svrgs_addon.render.passes import linear_rgba, overlay_rgba
from svrgs_bench.scenes import orbit_camera, room

CAMERA = orbit_camera(64, 40)


@pytest.fixture(scope="module")
def scene():
    return room(2000)


def image_of(picture, name: str) -> np.ndarray:
    return picture.rgb if name == "rgb" else picture.images[name]


def plane(z: float, rgb=(0.2, 0.6, 0.9), alpha: float = 1.0) -> Surface:
    shape = CAMERA.height, CAMERA.width
    return Surface(
        np.full(shape, z, np.float32),
        np.float32((*rgb, 1)) * np.float32(alpha) * np.ones((*shape, 1), np.float32),
    )


def depths(scene) -> np.ndarray:
    return scene.means @ CAMERA.viewmat[2, :3] + CAMERA.viewmat[2, 3]


def test_without_a_surface_it_is_the_rasterizers_picture(scene):
    picture = composite(Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3))
    expected = Rasterizer().forward(
        scene,
        CAMERA,
        RenderOptions(background=(0.1, 0.2, 0.3), mask_kind="svr"),
        outputs=("rgb", "mask", "hits"),
    )
    for name, image in expected.items():
        np.testing.assert_array_equal(image_of(picture, name), image)


def test_a_flat_surface_hides_what_lies_behind_it(scene):
    z = float(np.median(depths(scene)))
    picture = composite(Rasterizer(), scene, CAMERA, surface=plane(z))
    before = scene.select(depths(scene) <= z)
    expected = Rasterizer().forward(
        before,
        CAMERA,
        RenderOptions(background=(0.2, 0.6, 0.9), mask_kind="svr"),
        outputs=("rgb", "mask", "hits", "alpha", "depth"),
    )
    for name in ("rgb", "alpha", "mask", "hits"):
        np.testing.assert_allclose(image_of(picture, name), expected[name], atol=2e-5, rtol=1e-5)
    np.testing.assert_allclose(picture.depth, expected["depth"] + (1 - expected["alpha"]) * z, rtol=1e-5)
    assert (picture.coverage == 1).all()


def test_a_slope_hides_at_every_pixel_what_lies_behind_it_there(scene):
    slope = plane(0)
    slope.depth[:] = np.linspace(depths(scene).min() - 1, depths(scene).max() + 1, CAMERA.width)
    slope.depth[:, 48:], slope.rgba[:, 48:] = np.inf, 0
    picture = composite(Rasterizer(), scene, CAMERA, surface=slope)
    whole = composite(Rasterizer(), scene, CAMERA)
    for name in ("rgb", "alpha", "mask", "hits", "depth"):
        np.testing.assert_array_equal(image_of(picture, name)[:, 48:], image_of(whole, name)[:, 48:])
    assert (picture.images["hits"][:, 0] == 0).all() and (picture.coverage[:, :48] == 1).all()
    for column in (12, 25, 40):
        flat = composite(Rasterizer(), scene, CAMERA, surface=plane(slope.depth[0, column]))
        for name in ("rgb", "alpha", "mask", "hits", "depth"):
            np.testing.assert_array_equal(image_of(picture, name)[:, column], image_of(flat, name)[:, column])


def test_a_pixel_at_an_edge_is_the_mean_of_both_pictures(scene):
    """A plane before another one, before everything, or with nothing behind it, in a quarter of some
    pixels."""
    near, far = np.percentile(depths(scene), (30, 60))
    share = np.where(np.arange(CAMERA.width) % 3 == 0, np.float32(0.25), np.float32(1)) * np.ones(
        (CAMERA.height, 1), np.float32
    )
    for rest in (plane(float(far), (1, 0, 0)), plane(np.inf, (0, 0, 0), 0)):
        front = plane(float(near))
        picture = composite(
            Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3), Surface(front.depth, front.rgba, share, rest)
        )
        one, other = (
            composite(Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3), surface) for surface in (front, rest)
        )
        for name in ("rgb", "alpha", "mask", "hits"):
            weight = share[..., None] if name == "rgb" else share
            np.testing.assert_allclose(
                image_of(picture, name),
                weight * image_of(one, name) + (1 - weight) * image_of(other, name),
                atol=1e-5,
            )
        np.testing.assert_allclose(
            picture.coverage, share * one.coverage + (1 - share) * other.coverage, atol=1e-6
        )
        weights = share * one.coverage, (1 - share) * other.coverage
        some = picture.coverage > 1e-3
        mean = (weights[0] * one.depth + weights[1] * np.where(weights[1] > 0, other.depth, 0)) / np.maximum(
            picture.coverage, 1e-9
        )
        np.testing.assert_allclose(picture.depth[some], mean[some], rtol=1e-5)


@pytest.mark.parametrize("transparent", [False, True])
def test_a_holdout_is_a_hole_with_gaussians_before_it(scene, transparent):
    z = float(np.median(depths(scene)))
    before = scene.select(depths(scene) <= z)
    background = (0.0, 0.0, 0.0) if transparent else (0.3, 0.2, 0.1)
    film = linear_rgba(composite(Rasterizer(), scene, CAMERA, background, plane(z, alpha=0)), transparent)
    expected = linear_rgba(composite(Rasterizer(), before, CAMERA), True)
    np.testing.assert_allclose(film, expected, atol=2e-4)
    assert film[..., 3].min() < 0.5, "there are holes"


def test_a_picture_split_at_a_surface_is_whole_again_without_the_surface(scene):
    """Front over behind, blended as Gaussians are."""
    slope = plane(0)
    slope.depth[:] = np.linspace(depths(scene).min() - 1, depths(scene).max() + 1, CAMERA.width)
    slope.depth[:, 48:], slope.rgba[:, 48:] = np.inf, 0
    parts, whole = split(Rasterizer(), scene, CAMERA, surface=slope), composite(Rasterizer(), scene, CAMERA)
    T = 1 - parts.coverage[..., None]
    both = np.concatenate([parts.rgb, parts.coverage[..., None]], axis=2) + T * parts.behind
    np.testing.assert_allclose(
        both, np.concatenate([whole.rgb, whole.coverage[..., None]], axis=2), atol=1e-5
    )
    assert not parts.behind[:, 48:].any() and parts.behind[:, 8:40, 3].max() > 0.5
    front = composite(Rasterizer(), scene, CAMERA, surface=Surface(slope.depth, np.zeros_like(slope.rgba)))
    np.testing.assert_array_equal(parts.rgb, front.rgb)


def test_a_background_is_behind_all_of_a_split_picture(scene):
    found, clear = (
        split(Rasterizer(), scene, CAMERA, background, plane(float(np.median(depths(scene)))))
        for background in ((0.1, 0.2, 0.3), None)
    )
    np.testing.assert_array_equal(found.rgb, clear.rgb)
    assert (found.behind[..., 3] == 1).all()
    np.testing.assert_allclose(
        found.behind[..., :3],
        clear.behind[..., :3] + (1 - clear.behind[..., 3:]) * (0.1, 0.2, 0.3),
        atol=1e-6,
    )


def test_what_lies_on_a_shadow_catcher_is_behind_it(scene):
    z = float(np.median(depths(scene)))
    mesh, catcher = plane(1.5 * z), plane(z)
    found = split(Rasterizer(), scene, CAMERA, None, mesh, catcher)
    np.testing.assert_array_equal(
        found.rgb, split(Rasterizer(), scene, CAMERA, None, plane(z * np.float32(1 - ON_CATCHER))).rgb
    )
    far = split(Rasterizer(), scene, CAMERA, None, plane(0.5 * z), catcher)
    np.testing.assert_array_equal(far.rgb, split(Rasterizer(), scene, CAMERA, None, plane(0.5 * z)).rgb)
    assert not split(Rasterizer(), scene, CAMERA).behind.any()


@pytest.mark.parametrize("background", [None, (0.1, 0.2, 0.3)])
def test_behind_a_holdout_a_split_picture_has_nothing(scene, background):
    z = float(np.median(depths(scene)))
    half = plane(z)
    half.rgba[:, : CAMERA.width // 2] = 0
    behind = split(Rasterizer(), scene, CAMERA, background, half).behind
    assert not behind[:, : CAMERA.width // 2].any() and behind[:, CAMERA.width // 2 :, 3].max() > 0.5


def test_nothing_at_all_is_far_away():
    picture = composite(Rasterizer(), scenes.empty_scene(), CAMERA)
    assert (picture.depth == FAR).all() and not picture.coverage.any()


def test_a_drawing_nobody_wants_any_more_stops(scene):
    assert (
        composite_while(lambda: False, Rasterizer(), composite, room(300_000), orbit_camera(1920, 1080))
        is None
    )
    assert composite_while(lambda: True, Rasterizer(), composite, scene, CAMERA) is not None


def test_errors_of_a_drawing_come_through():
    with pytest.raises(AttributeError):
        composite_while(lambda: True, Rasterizer(), composite, None, CAMERA)


def test_the_film_encodes_back_to_the_drawing(scene):
    picture = composite(Rasterizer(), scene, CAMERA)
    opaque, clear = linear_rgba(picture, False), linear_rgba(picture, True)
    np.testing.assert_allclose(linear_to_srgb(opaque[..., :3]), picture.rgb, atol=1e-6)
    assert (opaque[..., 3] == 1).all()
    straight = clear[..., :3] / np.maximum(clear[..., 3:], 1e-9)
    np.testing.assert_allclose(linear_to_srgb(straight) * clear[..., 3:], picture.rgb, atol=1e-5)


def test_another_working_space_holds_the_same_colours(scene):
    picture, swapped = composite(Rasterizer(), scene, CAMERA), ((0, 1, 0), (1, 0, 0), (0, 0, 1))
    np.testing.assert_array_equal(
        linear_rgba(picture, False, swapped)[..., [1, 0, 2, 3]], linear_rgba(picture, False)
    )


def test_laid_over_a_picture_it_shows_what_is_before_it(scene):
    hidden = plane(float(np.median(depths(scene)))).depth
    rgba = overlay_rgba(Rasterizer(), scene, CAMERA, hidden)
    picture = composite(Rasterizer(), scene, CAMERA, surface=plane(hidden[0, 0], (1, 1, 1)))
    np.testing.assert_allclose(rgba[..., :3] + (1 - rgba[..., 3:]), picture.rgb, atol=1e-6)


def test_passes_that_nobody_asked_for_are_not_rendered(scene):
    for surface in (None, plane(float(np.median(depths(scene))))):
        whole, part = (
            composite(Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3), surface, passes)
            for passes in (PASS_OUTPUTS, ())
        )
        assert (part.rgb == whole.rgb).all() and (part.coverage == whole.coverage).all()
        assert (part.holes == whole.holes).all()
        assert set(part.images) == {"alpha"} and set(whole.images) == set(PASS_OUTPUTS)
        depth = composite(Rasterizer(), scene, CAMERA, (0.1, 0.2, 0.3), surface, ("depth",))
        assert (depth.depth == whole.depth).all() and set(depth.images) == {"depth", "alpha"}


def test_a_pixel_that_is_covered_less_than_half_has_no_solid_depth():
    coverage = np.array([[0.0, 0.4, 0.6]], np.float32)
    picture = Composite(
        np.zeros((1, 3, 3)), coverage, 0 * coverage, {"depth": np.full((1, 3), 7, np.float32)}
    )
    assert picture.solid_depth.tolist() == [[np.float32(FAR), np.float32(FAR), 7]]
