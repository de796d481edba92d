"""Hostile scenes, poisoned values, absurd sizes and wrong arguments: finite or refused, and nobody else is harmed."""

import math
import os
import subprocess
import sys
import time
import weakref
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

import scenes
from native_helpers import (
    ARRAYS,
    BACKGROUND,
    FLOAT_LEVELS,
    IMAGES,
    LEVELS,
    assert_finite,
    assert_same_bits,
    backward,
    frontal,
    image_weights,
    isotropic,
    rasterizer,
    render,
    typed,
)
from svrgs_addon import native
from svrgs_addon.camera import Camera
from svrgs_addon.errors import NativeError
from svrgs_addon.native import Rasterizer, RenderOptions, sample_masks

CAMERAS = scenes.CAMERAS | scenes.ORTHOGRAPHIC
FLOAT_MAX = float(np.finfo(np.float32).max)


def view_and_gradients(level, scene, camera, masks=None, seed=0, **options):
    """Images and gradients of one view, everything asked for."""
    images = render(level, scene, camera, masks, **options)
    grads = backward(level, image_weights(camera, seed), len(scene.means))
    return images, grads


def assert_in_range(images: dict[str, np.ndarray]):
    """What holds for any scene whose colours are not negative."""
    assert_finite(images)
    for name in ("rgb", "depth", "mask"):
        assert images[name].min() >= -1e-6, name
    for name in ("alpha", "transmittance"):
        assert images[name].min() >= 0 and images[name].max() <= 1, name
    assert (0 <= images["kept"]).all() and (images["kept"] <= images["hits"]).all()


# --- hostile scenes


HOSTILE_CAMERAS = ("plain", "rotated", "off_centre", "outside", "wide", "narrow", "inside", "pixel", "parallel_plain", "parallel_inside")


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", scenes.HOSTILE_SCENES)
def test_hostile_scenes_stay_finite(kind, level):
    drawn = 0
    for seed, name in enumerate(HOSTILE_CAMERAS):
        scene, masks = scenes.HOSTILE_SCENES[kind](60, seed, seed % 4), scenes.random_masks(60, seed)
        for antialiased, mask_kind in ((False, "svr"), (True, "a"), (False, "b")):
            images, grads = view_and_gradients(level, scene, CAMERAS[name], masks, antialiased=antialiased, mask_kind=mask_kind)
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
        expected = scenes.reference_render(scenes.leaves(scene, requires_grad=False), masks, camera, BACKGROUND)
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
    """Log-scales −30 … 45, quaternions 1e±28, distances to 1e30, needles 1e20 long beside the view, all mixed."""
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


# --- poison


FINITE_POISON = (0.0, -0.0, 1e-45, -1e-45, 1e-38, 1e38, -1e38, FLOAT_MAX, -FLOAT_MAX)
SLOTS = [(name, k) for name, width in zip(ARRAYS, (3, 3, 4, 1, 12), strict=True) for k in range(width)]


def poisoned(level, array: str, slot: int, value: float):
    """A scene whose Gaussian 5 has one bad value, the same scene without it, and which rows those are."""
    scene = scenes.random_scene(12, 1, 1, scale=0.3)
    others = np.arange(12) != 5
    bad = typed(scene, rasterizer(level).dtype)
    getattr(bad, array)[5].reshape(-1)[slot : slot + 1] = value
    if array == "opacity_logits":
        bad.opacity_logits[5] = value
    return bad, scene.select(others), others


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("array", "slot"), SLOTS)
@pytest.mark.parametrize("antialiased", [False, True])
def test_values_that_are_not_finite_draw_nothing(array, slot, level, antialiased):
    """The poisoned Gaussian is culled, its gradient zero, every other bit as without it."""
    camera = scenes.CAMERAS["rotated"]
    for value in (np.nan, np.inf, -np.inf):
        if array == "opacity_logits" and value == np.inf:
            continue  # an opacity of exactly 1: see below
        bad, without, others = poisoned(level, array, slot, value)
        images, grads = view_and_gradients(level, bad, camera, antialiased=antialiased)
        assert 5 not in rasterizer(level).visible()
        expected, expected_grads = view_and_gradients(level, without, camera, antialiased=antialiased)
        assert_same_bits(images, expected)
        assert not any(g[5].any() for g in grads.values())
        assert_same_bits({name: g[others] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize(("array", "slot"), SLOTS)
def test_extreme_finite_values_stay_finite(array, slot, level):
    """Drawn or culled; if culled, every other bit is as without it."""
    for name in ("plain", "rotated"):
        camera = CAMERAS[name]
        for value in FINITE_POISON:
            bad, without, others = poisoned(level, array, slot, value)
            images, grads = view_and_gradients(level, bad, camera)
            assert_in_range(images)
            assert_finite(grads)
            if 5 in rasterizer(level).visible():
                continue
            expected, expected_grads = view_and_gradients(level, without, camera)
            assert_same_bits(images, expected)
            assert_same_bits({name: g[others] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
def test_a_drawn_poison_leaves_pixels_it_does_not_touch(level):
    """A Gaussian in the left half, made very bright, opaque or small; the right half keeps its bits."""
    camera = frontal(64, 32)
    base = isotropic([(-1.0, 0, 2), (0.5, 0, 2), (1.0, 0.2, 3)], scale=0.1)
    others = SimpleNamespace(**{name: getattr(base, name)[1:].copy() for name in ARRAYS})
    expected = render(level, others, camera)["rgb"][:, 32:]
    poison = [("opacity_logits", np.inf), ("sh", 1e5), ("sh", -1e38), ("log_scales", -1e38), ("quats", 1e15)]
    for array, value in poison:
        bad = typed(base, np.float64)
        getattr(bad, array)[0] = value
        images, grads = view_and_gradients(level, bad, camera)
        assert 0 in rasterizer(level).visible() or array == "sh"
        assert_finite(images | grads)
        np.testing.assert_array_equal(images["rgb"][:, 32:], expected)


@pytest.mark.parametrize("level", LEVELS)
def test_hostile_quaternions_change_no_other_pixel(level):
    """500 Gaussians of zero, tiny, huge and non-finite quaternions among 20 good ones."""
    scene, crowd = scenes.random_scene(20, 1, 0, scale=0.3), scenes.random_scene(500, 2, 0, scale=0.3)
    lengths = np.array([0, 1e-44, 1e-30, 1e-25, 1e25, 1e37, np.inf, np.nan])
    crowd.quats[:] *= lengths[np.arange(500) % 8, None].astype(np.float32)
    both = typed(scene, np.float64)
    for name in ARRAYS:
        setattr(both, name, np.concatenate([getattr(both, name), getattr(crowd, name)]))
    images, grads = view_and_gradients(level, both, scenes.CAMERAS["plain"])
    expected, expected_grads = view_and_gradients(level, scene, scenes.CAMERAS["plain"])
    assert_same_bits(images, expected)
    assert_same_bits({name: g[:20] for name, g in grads.items()}, expected_grads)


@pytest.mark.parametrize("level", LEVELS)
def test_length_of_a_quaternion_does_not_matter(level):
    scene, camera = scenes.random_scene(30, 1, 0, scale=0.3), scenes.CAMERAS["plain"]
    expected, expected_grads = view_and_gradients(level, scene, camera)
    for length in (1e-8, 1e-3, 1e3, 1e8):
        longer = typed(scene, np.float64)
        longer.quats *= length
        images, grads = view_and_gradients(level, longer, camera)
        np.testing.assert_allclose(images["rgb"], expected["rgb"], atol=2e-6)
        scale = np.abs(expected_grads["quats"]).max()
        np.testing.assert_allclose(grads["quats"] * length, expected_grads["quats"], atol=1e-4 * scale)


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
    for logits, visible, alpha in (((40, -40, 40), [0, 2], 0.99), ((-40, 40, -40), [1], 0.99), ((-40,) * 3, [], 0.0)):
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
    for z, visible in ((-1.0, False), (0.0, False), (0.1999999, False), (0.2000001, True), (1e10, True), (1e20, False)):
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
    viewmat[:3, 3] -= viewmat[:3, :3] @ offset
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


# --- sizes


REFUSED_SIZES = [(0, 5), (5, 0), (-1, 5), (5, -3), (32_769, 1), (1, 32_769), (2**31 - 1, 2**31 - 1)]


@pytest.mark.parametrize(("width", "height"), REFUSED_SIZES)
def test_image_sizes_outside_the_limits_are_refused(width, height):
    r = rasterizer("scalar")
    camera = Camera(np.eye(4), np.eye(3), width, height)
    with pytest.raises(NativeError, match="1 to 32768"):
        r.forward(typed(scenes.random_scene(3), r.dtype), camera, outputs=())


@pytest.mark.parametrize(("width", "height"), [(32_768, 1), (1, 32_768)])
def test_longest_images_work(width, height):
    images = render("scalar", isotropic([(0, 0, 2)], scale=1e5), frontal(width, height), outputs=("hits",))
    assert (images["hits"] == 1).all()


def test_too_many_pairs_are_refused_with_their_number():
    r, camera = rasterizer("scalar"), scenes.camera(64, 48)
    scene = typed(isotropic([(0, 0, z) for z in range(10)], scale=1e3), r.dtype)
    r.forward(scene, camera, RenderOptions(max_pairs=40))
    assert r.work()["pairs"] == 10 * 2 * 2
    with pytest.raises(NativeError, match=r"40 .* pairs.* 39"):
        r.forward(scene, camera, RenderOptions(max_pairs=39))
    with pytest.raises(NativeError):  # there is no view to differentiate now
        r.backward({})


def test_more_pairs_than_an_index_holds_are_refused_before_allocation():
    """2,400 Gaussians on each of 1024² tiles: 2.5e9 pairs would need 60 GB."""
    r = Rasterizer()
    scene = typed(isotropic([(0, 0, 2 + 0.01 * k) for k in range(2400)], scale=1e5), r.dtype)
    start = time.monotonic()
    with pytest.raises(NativeError, match=f"{2400 * 1024**2} .* pairs.* {2**31 - 1}"):
        r.forward(scene, frontal(32_768, 32_768, focal=2e4), outputs=())
    assert time.monotonic() - start < 5


@pytest.mark.parametrize(
    "change",
    [
        {"K": np.diag([0.0, 20, 1])},
        {"K": np.diag([20.0, -20, 1])},
        {"K": np.diag([np.inf, 20, 1])},
        {"K": np.diag([np.nan, 20, 1])},
        {"K": np.array([[20.0, 0, np.nan], [0, 20, 0], [0, 0, 1]])},
        {"viewmat": np.full((4, 4), np.nan)},
        {"viewmat": np.diag([1, 1, np.inf, 1])},
        {"orthographic": 2},
    ],
)
def test_broken_cameras_are_refused(change):
    r, camera = rasterizer("scalar"), frontal(5, 5)
    broken = Camera(**{"viewmat": camera.viewmat, "K": camera.K, "width": 5, "height": 5} | change)
    with pytest.raises(NativeError, match="camera|focal|orthographic"):
        r.forward(typed(scenes.random_scene(3), r.dtype), broken)


@pytest.mark.parametrize(
    ("options", "error"),
    [
        ({"background": (0, np.nan, 0)}, NativeError),
        ({"sh_degree": -1}, NativeError),
        ({"mask_kind": "a", "eps_a": 0.0}, NativeError),
        ({"mask_kind": "a", "eps_a": np.nan}, NativeError),
        ({"mask_kind": "nonsense"}, (KeyError, ValueError)),
    ],
)
def test_broken_options_are_refused(options, error):
    r = rasterizer("scalar")
    with pytest.raises(error):
        r.forward(typed(scenes.random_scene(3), r.dtype), frontal(5, 5), RenderOptions(**options))


def test_calls_out_of_order_are_refused():
    r = Rasterizer("scalar")
    scores = np.zeros(3), np.zeros(3, np.float32), np.zeros(3, np.int64)
    for call in (lambda: r.backward({}), lambda: r.add_scores(*scores)):
        with pytest.raises(NativeError, match="forward"):
            call()
    r.forward(typed(scenes.random_scene(3), r.dtype), frontal(5, 5), outputs=("rgb",))
    with pytest.raises(NativeError, match="depth"):
        r.backward({"depth": np.ones((5, 5), r.dtype)})


def test_unknown_names_are_refused():
    r, ones = Rasterizer("scalar"), np.ones((5, 5), np.float32)
    scene = typed(scenes.random_scene(3), r.dtype)
    with pytest.raises(ValueError, match="colour"):
        r.forward(scene, frontal(5, 5), outputs=("colour",))
    r.forward(scene, frontal(5, 5))
    for name in ("colour", "transmittance", "hits"):  # the last two are images, but have no gradient
        with pytest.raises(ValueError, match=name):
            r.backward({name: ones})
    with pytest.raises(ValueError, match="opacity"):
        r.backward({"alpha": ones}, ("opacity",))
    with pytest.raises(ValueError, match="sse9"):
        Rasterizer("sse9")


def test_a_thousand_renderers_come_and_go():
    scene = scenes.random_scene(20, 1, 0)
    for _ in range(1000):
        r = Rasterizer()
        r.forward(typed(scene, r.dtype), frontal(20, 20), outputs=())
    assert r.visible().size


COMING_AND_GOING = """
import _ctypes, gc, hashlib, os, sys
from svrgs_addon.bench.scenes import orbit_camera, room
scene, camera, found = room(500, 1), orbit_camera(64, 48), set()
before = len(os.listdir("/proc/self/task")) if os.path.exists("/proc/self/task") else 0
for _ in range(20):
    from svrgs_addon import native
    native.set_threads(3)
    found.add(hashlib.sha256(native.Rasterizer().forward(scene, camera)["rgb"]).hexdigest())
    native.set_threads(1)
    gc.collect()
    handle = native._library()._handle
    del native
    for name in ("native", "native_library"):
        del sys.modules["svrgs_addon"].__dict__[name], sys.modules[f"svrgs_addon.{name}"]
    _ctypes.dlclose(handle)
assert not before or len(os.listdir("/proc/self/task")) == before, "threads are left"
print(len(found))
"""


@pytest.mark.skipif(os.name == "nt", reason="its libraries are let go of by another call")
def test_the_library_comes_and_goes_and_comes():
    done = subprocess.run([sys.executable, "-c", COMING_AND_GOING], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr


# --- the layer that checks arguments


OTHER_PRECISION = {"float32": "f8", "float64": "f4", "int64": "i4", "uint32": "u8", "uint8": "u2"}


def wrong_versions(array: np.ndarray, writes: bool, optional: bool) -> dict[str, object]:
    """Everything an argument of this type and shape must not be."""
    other = {"f": np.int32, "i": np.float32, "u": np.int64}[array.dtype.kind]
    wide = np.zeros((*array.shape[:-1], 2 * array.shape[-1]), array.dtype)
    wrong = {
        "other type": array.astype(other),
        "other precision": array.astype(OTHER_PRECISION[array.dtype.name]),
        "swapped bytes": array.astype(array.dtype.newbyteorder()),
        "a row less": array[:-1].copy(),
        "a row more": np.concatenate([array, array[:1]]),
        "flat": array.reshape(-1) if array.ndim > 1 else array.reshape(-1, 1),
        "another axis": array[..., None],
        "strided": wide[..., ::2],
        "backwards": array[::-1],
        "scalar": array.dtype.type(0),
        "list": array.tolist(),
    }
    if array.dtype.itemsize == 1:  # one byte has no order
        del wrong["swapped bytes"]
        wrong["truth values"] = array.astype(bool)
    if array.ndim > 1:
        wrong["Fortran order"] = np.asfortranarray(array)
        wrong["transposed"] = np.ascontiguousarray(array.T)
    if writes:
        wrong["read-only"] = array.copy()
        wrong["read-only"].setflags(write=False)
    if not optional:
        wrong["nothing"] = None
    return wrong


def real(*shape: int) -> np.ndarray:
    return np.zeros(shape, np.float32)


def prepared_rasterizer() -> Rasterizer:
    r = Rasterizer("scalar")
    scene = typed(scenes.random_scene(7, 1, 1), r.dtype)
    r.forward(scene, frontal(6, 5), RenderOptions(mask_kind="svr"), outputs=IMAGES)
    return r


def call_forward(r, masks, depth_limit, **arrays):
    return r.forward(SimpleNamespace(**arrays), frontal(6, 5), masks=masks, depth_limit=depth_limit)


def call_backward(r, **weights):
    return r.backward(weights)


def call_adam(r, param, moments, grad, ids):
    return r.adam(param, moments, grad, ids, lr=0.1, step=1)


CALLS = {  # call: {argument: (a right value, written to, may be None)}
    call_forward: {
        "means": (real(7, 3), False, False),
        "log_scales": (real(7, 3), False, False),
        "quats": (real(7, 4) + 1, False, False),
        "opacity_logits": (real(7), False, False),
        "sh": (real(7, 4, 3), False, False),
        "masks": (np.ones(7, np.uint8), False, True),
        "depth_limit": (real(5, 6), False, True),
    },
    call_backward: {
        "rgb": (real(5, 6, 3), False, False),
        "depth": (real(5, 6), False, False),
        "alpha": (real(5, 6), False, False),
        "mask": (real(5, 6), False, False),
    },
    Rasterizer.add_scores: {
        "sum_": (np.zeros(7), True, False),
        "max_": (real(7), True, False),
        "hits": (np.zeros(7, np.int64), True, False),
    },
    Rasterizer.loss: {"image": (real(5, 6, 3), False, False), "target": (real(5, 6, 3), False, False)},
    call_adam: {
        "param": (real(7, 3), True, False),
        "moments": (np.zeros((7, 3), np.uint32), True, False),
        "grad": (real(4, 3), False, False),
        "ids": (np.arange(4, dtype=np.uint32), False, True),
    },
}
ARGUMENTS = [(call, name) for call, arguments in CALLS.items() for name in arguments]


@pytest.mark.parametrize(("call", "name"), ARGUMENTS, ids=lambda x: getattr(x, "__name__", x))
def test_wrong_arguments_are_type_errors(call, name):
    """Wrong type, byte order, shape, strides, or read-only where the library writes; nothing is called."""
    r = prepared_rasterizer()
    right = {k: array for k, (array, _, _) in CALLS[call].items()}
    call(r, **right)
    array, writes, optional = CALLS[call][name]
    for what, wrong in wrong_versions(array, writes, optional).items():
        with pytest.raises(TypeError):
            call(r, **right | {name: wrong})
            pytest.fail(f"{name}: {what} was accepted")
    call(r, **right)


def test_wrong_logits_are_type_errors():
    for what, wrong in wrong_versions(real(7), writes=False, optional=False).items():
        if what in ("a row less", "a row more"):
            continue
        with pytest.raises(TypeError):
            sample_masks(wrong, 0, 0)
            pytest.fail(f"{what} was accepted")


def test_arrays_of_a_view_stay_alive_until_the_next():
    """The library still reads them in the backward pass, whatever becomes of the scene."""
    r, scene, masks = Rasterizer("scalar"), typed(scenes.random_scene(7, 1, 1), np.float32), np.ones(7, np.uint8)
    arrays = [weakref.ref(a) for a in (*vars(scene).values(), masks)]
    r.forward(scene, frontal(6, 5), masks=masks)
    vars(scene).clear()
    del scene, masks
    assert all(array() is not None for array in arrays)
    r.forward(typed(scenes.random_scene(3), np.float32), frontal(6, 5))
    assert all(array() is None for array in arrays)


@pytest.mark.parametrize("level", LEVELS)
def test_arrays_of_the_other_precision_are_type_errors(level):
    r = rasterizer(level)
    other = typed(scenes.random_scene(3), np.float32 if level == "float64" else np.float64)
    with pytest.raises(TypeError, match="float"):
        r.forward(other, frontal(5, 5))


def test_sh_of_no_degree_is_refused():
    r = rasterizer("scalar")
    for coefficients in (0, 2, 3, 5, 17):
        scene = typed(scenes.random_scene(3), r.dtype)
        scene.sh = np.zeros((3, coefficients, 3), np.float32)
        with pytest.raises((NativeError, TypeError)):
            r.forward(scene, frontal(5, 5))


def test_interface_version_is_that_of_the_library():
    assert native._library().svrgs_interface_version() == native.INTERFACE_VERSION
