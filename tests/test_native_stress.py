"""Hostile scenes, opacities at the cut, many Gaussians on one pixel, and far places: the native core stays
finite."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from native_helpers import (
    BACKGROUND,
    FLOAT_LEVELS,
    LEVELS,
    assert_finite,
    assert_in_range,
    frontal,
    isotropic,
    rasterizer,
    render,
    typed,
    view_and_gradients,
)
from svrgs_addon.scene.camera import Camera

CAMERAS = scenes.CAMERAS | scenes.ORTHOGRAPHIC


# --- hostile scenes


HOSTILE_CAMERAS = (
    "plain rotated off_centre outside wide narrow inside pixel parallel_plain parallel_inside".split()
)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", scenes.HOSTILE_SCENES)
def test_hostile_scenes_stay_finite(kind, level):
    drawn = 0
    for seed, name in enumerate(HOSTILE_CAMERAS):
        scene, masks = scenes.HOSTILE_SCENES[kind](60, seed, seed % 4), scenes.random_masks(60, seed)
        for antialiased, mask_kind in ((False, "svr"), (True, "a"), (False, "b")):
            images, grads = view_and_gradients(
                level, scene, CAMERAS[name], masks, antialiased=antialiased, mask_kind=mask_kind
            )
            assert_in_range(images)
            assert_finite(grads)
            drawn += images["hits"].sum()
    assert drawn > 500


@pytest.mark.parametrize("kind", scenes.HOSTILE_SCENES)
def test_hostile_scenes_are_those_of_the_reference(kind):
    """float64: every pixel. Float: a hit at the very edge of the alpha cut may be decided differently."""
    scene, masks = scenes.HOSTILE_SCENES[kind](50, 3, 1), scenes.random_masks(50, 3)
    for name in ("plain", "off_centre", "inside", "parallel_rotated"):
        camera = CAMERAS[name]
        expected = scenes.reference_render(
            scenes.leaves(scene, requires_grad=False), masks, camera, BACKGROUND
        )
        exact = render("float64", scene, camera, masks)
        np.testing.assert_allclose(exact["rgb"], expected.rgb, rtol=1e-9, atol=1e-9)
        np.testing.assert_array_equal(exact["hits"], expected.N)
        for level in FLOAT_LEVELS:
            image = render(level, scene, camera, masks)
            error = np.abs(image["rgb"] - expected.rgb.numpy()).max(2)
            assert (error > 1e-5).mean() <= 0.02 and error.max() < 2 / 255
            assert (image["hits"] != expected.N.numpy()).mean() <= 0.02


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("seed", range(4))
def test_ranges_no_scene_has_stay_finite(level, seed):
    """Log-scales −30 … 45, quaternions 1e±28, distances to 1e30, needles 1e20 long beside the view, all
    mixed."""
    rng = np.random.default_rng(seed)
    n, drawn = 60, 0
    for family in range(4):
        scene = typed(scenes.random_scene(n, seed, int(seed) % 4, scale=0.3), rasterizer(level).dtype)
        if family == 0:
            scene.log_scales[:] = rng.uniform(-30, 45, (n, 3))
        elif family == 1:
            scene.quats *= 10 ** rng.uniform(-28, 28, (n, 1))
        elif family == 2:
            scene.means *= 10 ** rng.uniform(0, 29, (n, 1))
            scene.log_scales += np.log(10) * rng.uniform(0, 20, (n, 1))
        else:
            scene.means[:, :2] *= 10 ** rng.uniform(-3, 4, (n, 1))
            scene.means[:, 2] = -scenes.DISTANCE + 0.2 + 10 ** rng.uniform(-8, 2, n)
            scene.log_scales[:] = rng.uniform(-8, 12, (n, 3))
        for name in ("plain", "rotated", "wide", "narrow", "parallel_rotated"):
            for antialiased in (False, True):
                images, grads = view_and_gradients(level, scene, CAMERAS[name], antialiased=antialiased)
                assert_in_range(images)
                assert_finite(grads)
                drawn += images["hits"].sum()
    assert drawn > 1000


# --- opacity


@pytest.mark.parametrize("level", LEVELS)
def test_opacity_around_the_cut(level):
    """Seen at its centre: a hit just above 1/255, none just below."""
    for share, hits in ((1 + 1e-5, 1), (1 - 1e-5, 0)):
        scene = isotropic([(0, 0, 2)], opacity=share / 255)
        images, grads = view_and_gradients(level, scene, frontal(1, 1))
        assert images["hits"].item() == hits
        assert_finite(grads)
        assert bool(grads["masks"].any()) == bool(hits)
    assert images["rgb"].ravel() == pytest.approx(BACKGROUND, rel=1e-7)


@pytest.mark.parametrize("level", LEVELS)
def test_support_collapses_continuously_towards_the_cut(level):
    """As the opacity sinks to 1/255 the hit area shrinks to the pixels at the centre, and then to none."""
    areas = []
    for opacity in (0.5, 0.05, 0.01, 0.005, 0.004, 0.00393, 0.0039):
        scene = isotropic([(0.025, 0.025, 1)], scale=0.2, opacity=opacity)
        areas.append(render(level, scene, frontal(33, 33))["hits"].sum())
    assert areas == sorted(areas, reverse=True) and areas[0] > 400 and areas[4] > 0 and areas[-1] == 0


@pytest.mark.parametrize("level", LEVELS)
def test_logits_of_plus_and_minus_40(level):
    scene = isotropic([(0, 0, 2), (0, 0, 3), (0, 0, 4)])
    for logits, visible, alpha in (
        ((40, -40, 40), [0, 2], 0.99),
        ((-40, 40, -40), [1], 0.99),
        ((-40,) * 3, [], 0.0),
    ):
        scene.opacity_logits[:] = logits
        images, grads = view_and_gradients(level, scene, frontal(1, 1))
        np.testing.assert_array_equal(rasterizer(level).visible(), visible)
        assert images["alpha"].item() == pytest.approx(alpha, abs=1e-6)  # the second would leave T below 1e-4
        assert_finite(grads)
        assert not grads["opacity_logits"].any()  # clamped, or not there
        assert np.count_nonzero(grads["masks"]) == len(visible)


# --- many on one pixel


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("opacity", "blended"), [(1.02 / 255, 2297), (0.5, 13), (0.9999, 1)])
def test_ten_thousand_on_one_pixel(level, opacity, blended):
    n = 10_000
    scene = isotropic(np.column_stack([np.zeros((n, 2)), np.linspace(1, 5, n)]), opacity=opacity)
    images, grads = view_and_gradients(level, scene, frontal(1, 1))
    alpha = min(opacity, 0.99)
    assert images["hits"].item() == images["kept"].item() == n
    assert images["alpha"].item() == pytest.approx(1 - (1 - alpha) ** blended, abs=2e-6)
    assert images["transmittance"].item() == pytest.approx((1 - alpha) ** n, abs=1e-15, rel=1e-3)
    assert images["mask"].item() == pytest.approx((n - 1) / math.log1p(n), rel=1e-6)
    assert_in_range(images)
    assert_finite(grads)
    sum_ = np.zeros(n)
    rasterizer(level).add_scores(sum_, np.zeros(n, np.float32), np.zeros(n, np.int64))
    assert np.count_nonzero(sum_) == blended and sum_.sum() == pytest.approx(images["alpha"].item(), abs=1e-6)
    assert not grads["sh"][blended:].any() and grads["sh"][:blended].any((1, 2)).all()
    assert sum_.sum() <= 1


@pytest.mark.parametrize("level", LEVELS)
def test_screen_filling_gaussians_touch_every_tile(level):
    n, camera = 300, scenes.camera(70, 50)
    scene = isotropic(np.column_stack([np.zeros((n, 2)), np.linspace(-1, 1, n)]), scale=1e3, opacity=0.01)
    images, grads = view_and_gradients(level, scene, camera)
    assert rasterizer(level).work()["pairs"] == n * 3 * 2
    assert (images["hits"] == n).all()
    assert images["transmittance"] == pytest.approx(0.99**n, rel=1e-3)
    assert_in_range(images)
    assert_finite(grads)


# --- position


@pytest.mark.parametrize("level", LEVELS)
def test_near_plane(level):
    for z, visible in {
        -1.0: False,
        0.0: False,
        0.1999999: False,
        0.2000001: True,
        1e10: True,
        1e20: False,
    }.items():
        scene = isotropic([(0, 0, z)], scale=max(z, 0.1))
        images, grads = view_and_gradients(level, scene, frontal(5, 5))
        assert bool(len(rasterizer(level).visible())) == visible == bool(images["hits"].any()), z
        assert_in_range(images)
        assert_finite(grads)


@pytest.mark.parametrize("level", LEVELS)
def test_scenes_straddling_the_camera_plane(level):
    """Much larger than their distance, centre just in front of the near plane, also far aside."""
    rng = np.random.default_rng(0)
    means = np.column_stack([rng.normal(0, 3, (80, 2)), 0.2 + 10 ** rng.uniform(-6, 0, 80)])
    for scale in (0.01, 1, 100):
        images, grads = view_and_gradients(level, isotropic(means, scale=scale), frontal(40, 30))
        assert_in_range(images)
        assert_finite(grads)
        assert images["hits"].any()


def moved(scene, camera: Camera, offset) -> tuple[SimpleNamespace, Camera]:
    """The same view in a world whose origin lies elsewhere."""
    far, viewmat = typed(scene, np.float64), camera.viewmat.copy()
    far.means += offset
    # rounded once, on every processor
    viewmat[:3, 3] = viewmat[:3, 3] - viewmat[:3, :3].astype(np.longdouble) @ offset
    return far, replace(camera, viewmat=viewmat)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("name", ["plain", "rotated", "parallel_rotated"])
def test_a_world_a_million_units_away(level, name):
    """Centres on a grid that float32 still holds at 1e6, so the image must be the same."""
    scene = scenes.random_scene(60, 1, 0, scale=0.2)
    scene.means[:] = np.round(scene.means * 16) / 16
    camera = CAMERAS[name]
    far, far_camera = moved(scene, camera, np.array([1e6, -5e5, 1e6]))
    assert (far.means.astype(np.float32) == far.means).all()
    expected, (images, grads) = render(level, scene, camera), view_and_gradients(level, far, far_camera)
    assert_in_range(images)
    assert_finite(grads)
    assert np.abs(images["rgb"] - expected["rgb"]).max() <= (1e-9 if level == "float64" else 2e-6)
