"""What must hold in the native core, whatever the numbers: absence, identities of one view, and order."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
from native_helpers import (
    ARRAYS,
    BACKGROUND,
    CAMERA,
    IMAGES,
    LEVELS,
    assert_same_bits,
    backward,
    everything,
    frontal,
    image_weights,
    isotropic,
    rasterizer,
    render,
)
from svrgs_addon.native import library
from svrgs_addon.scene.gaussians import Scene


def joined(*parts: Scene) -> Scene:
    return Scene(*(np.concatenate([getattr(part, name) for part in parts]) for name in ARRAYS))


def rgb_gradients(level, scene, masks=None, **options):
    """Images, and the gradients of the colours alone."""
    images = render(level, scene, CAMERA, masks, **options)
    return images, backward(level, {"rgb": image_weights(CAMERA)["rgb"]}, len(scene.means))


# --- absence


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("make", [scenes.random_scene, scenes.opaque_stack])
@pytest.mark.parametrize("antialiased", [False, True])
def test_masked_equals_deleted(level, make, antialiased):
    """The same bits in C, depth, alpha, T and in every other Gaussian's gradient; K too, but not N."""
    scene, masks = make(60, 8, 2), scenes.random_masks(60, 8, keep=0.5)
    kept = masks == 1
    images, grads = rgb_gradients(level, scene, masks, antialiased=antialiased)
    fewer, fewer_grads = rgb_gradients(level, scene.select(kept), antialiased=antialiased)
    for name in ("rgb", "depth", "alpha", "transmittance", "kept"):
        np.testing.assert_array_equal(images[name], fewer[name], err_msg=name)
    assert_same_bits({k: g[kept] for k, g in grads.items()}, fewer_grads)
    assert (images["hits"] > fewer["hits"]).any()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "a"])
def test_masked_out_gaussians_learn_only_whether_to_exist(level, kind):
    scene, masks = scenes.random_scene(60, 3, 1, scale=0.3), scenes.random_masks(60, 3, keep=0.5)
    result = everything(level, scene, masks, mask_kind=kind)
    absent = masks == 0
    assert result["dmasks"][absent].any() and result["dmasks"][~absent].any()
    for name in (*ARRAYS, "means2d"):
        assert not result[f"d{name}"][absent].any(), name
        assert result[f"d{name}"][~absent].any(), name
    assert not result["sum"][absent].any() and not result["max"][absent].any()
    assert not result["pixels"][absent].any()


@pytest.mark.parametrize("level", LEVELS)
def test_all_masks_one_equals_no_masks(level):
    scene = scenes.random_scene(60, 4, 2, scale=0.3)
    assert_same_bits(everything(level, scene, np.ones(60)), everything(level, scene, None))


@pytest.mark.parametrize("level", LEVELS)
def test_culled_gaussians_change_no_bit(level):
    """Behind, too faint, aside: before, between and after the others."""
    scene, masks = scenes.random_scene(60, 5, 1, scale=0.3), scenes.random_masks(60, 5)
    behind, faint, aside = (scenes.random_scene(20, seed, 1) for seed in (6, 7, 8))
    behind.means[:, 2] = -scenes.DISTANCE + 0.2 - np.abs(behind.means[:, 2])
    faint.opacity_logits[:] = -5.6
    aside.means[:, 0] += 500
    culled = joined(behind, faint, aside)
    order = np.random.default_rng(0).permutation(120)
    # those of the scene keep their order
    order = order[np.argsort(np.where(order < 60, order, -1), kind="stable")]
    slots = np.random.default_rng(1).permutation(120) < 60
    index = np.empty(120, int)
    index[slots], index[~slots] = np.arange(60), order[:60]
    mixed, mixed_masks = joined(scene, culled).select(index), np.concatenate([masks, np.ones(60)])[index]

    alone, together = everything(level, scene, masks), everything(level, mixed, mixed_masks)
    visible = np.flatnonzero(slots)[alone.pop("visible")]
    np.testing.assert_array_equal(together.pop("visible"), visible)
    for name in alone.keys() - set(IMAGES):
        assert not together[name][~slots].any(), name
        together[name] = together[name][slots]
    assert_same_bits(together, alone)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", library.mask_kinds())
def test_nothing_to_draw_is_the_background(level, kind):
    behind, faint = scenes.random_scene(30, 1, 1), scenes.random_scene(30, 2, 1)
    behind.means[:, 2] = -10
    faint.opacity_logits[:] = -8
    for scene in (scenes.empty_scene(), behind, faint):
        result = everything(level, scene, mask_kind=kind)
        background = np.array(BACKGROUND, rasterizer(level).dtype)
        np.testing.assert_array_equal(result["rgb"], np.broadcast_to(background, (27, 40, 3)))
        assert (result["transmittance"] == 1).all() and rasterizer(level).work()["pairs"] == 0
        for name in result.keys() - {"rgb", "transmittance"}:
            assert not result[name].any(), name


# --- identities of one view


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("full", [True, False])
def test_mask_is_its_closed_form(level, full):
    scene, masks = scenes.opaque_stack(40, 5, 0), scenes.random_masks(40, 5)
    image = render(level, scene, CAMERA, masks, full=full)
    N, K, T = (image[name].astype(np.float64) for name in ("hits", "kept", "transmittance"))
    np.testing.assert_allclose(
        image["mask"], (K - 1 + T) / np.log1p(N), rtol=3e-7 if level != "float64" else 1e-15
    )
    assert N.min() > 0 and (K < N).any()


@pytest.mark.parametrize("level", LEVELS)
def test_mask_gradient_lies_in_its_range(level):
    """0 < dF/dM ≤ 1 / log(1 + N) at one pixel, and 0 for what does not hit it."""
    scene, masks, camera = scenes.opaque_stack(30, 6, 0), scenes.random_masks(30, 6), scenes.camera(1, 1)
    image = render(level, scene, camera, masks)
    gradient = backward(level, {"mask": np.ones((1, 1))}, 30, ("masks",))["masks"]
    assert 5 < np.count_nonzero(gradient) == image["hits"].item()
    assert gradient.min() >= 0
    assert gradient.max() <= np.float32(1 / np.log1p(image["hits"].item())) * (1 + 1e-7)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("make", [scenes.random_scene, scenes.opaque_stack])
def test_weights_and_remaining_transmittance_sum_to_one(level, make):
    """Over a whole image: the scores' sum of alpha T against the T that is left, which stops with the
    colours."""
    scene, masks = make(80, 6, 1), scenes.random_masks(80, 6)
    result = everything(level, scene, masks, full=False)
    pixels = CAMERA.width * CAMERA.height
    assert result["sum"].sum() + result["transmittance"].sum(dtype=np.float64) == pytest.approx(
        pixels, rel=1e-6
    )
    np.testing.assert_allclose(result["alpha"] + result["transmittance"], 1, rtol=0, atol=6e-8)


@pytest.mark.parametrize("level", LEVELS)
def test_full_and_visible_differ_in_the_mask_only(level):
    scene, masks = scenes.opaque_stack(40, 7, 0), scenes.random_masks(40, 7)
    full, visible = (render(level, scene, CAMERA, masks, full=full) for full in (True, False))
    assert_same_bits(*({k: i[k] for k in ("rgb", "depth", "alpha")} for i in (full, visible)))
    stopped = full["hits"] > visible["hits"]
    assert stopped.mean() > 0.5 and (full["hits"] >= visible["hits"]).all()
    assert (full["kept"] >= visible["kept"]).all()
    assert (full["transmittance"][stopped] < 1e-4).all() and (visible["transmittance"] >= 1e-4).all()
    thin = scenes.random_scene(40, 7, 0, opacity=-1.0)
    modes = [everything(level, thin, masks, full=full) for full in (True, False)]
    assert modes[0]["transmittance"].min() > 1e-3  # nothing stops, so the modes agree
    assert_same_bits(*modes)


@pytest.mark.parametrize("level", LEVELS)
def test_mask_kind_changes_no_colour(level):
    scene, masks = scenes.opaque_stack(40, 8, 1), scenes.random_masks(40, 8)
    plain, plain_grads = rgb_gradients(level, scene, masks, mask_kind="none")
    assert not plain["mask"].any()
    for kind in ("svr", "self", "a", "b"):
        images, grads = rgb_gradients(level, scene, masks, mask_kind=kind)
        assert_same_bits(*({k: i[k] for k in ("rgb", "depth", "alpha")} for i in (images, plain)))
        assert_same_bits(grads, plain_grads)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("kind", ["svr", "self", "a", "b", "even"])
def test_the_spatial_mask_reaches_the_masks_only(level, kind):
    scene, masks = scenes.random_scene(40, 9, 1, scale=0.3), scenes.random_masks(40, 9)
    render(level, scene, CAMERA, masks, mask_kind=kind)
    grads = backward(level, {"mask": image_weights(CAMERA)["mask"]}, 40)
    assert {name for name, gradient in grads.items() if gradient.any()} == {"masks"}


@pytest.mark.parametrize("level", LEVELS)
def test_gradients_are_linear_in_the_image_gradients(level):
    """Four images at once equal the sum of one at a time."""
    scene, masks = scenes.random_scene(40, 9, 1, scale=0.3), scenes.random_masks(40, 9)
    weights = image_weights(CAMERA)
    render(level, scene, CAMERA, masks)
    together = backward(level, weights, 40)
    parts = [backward(level, {name: w}, 40) for name, w in weights.items()]
    for name, gradient in together.items():
        total = sum(part[name].astype(np.float64) for part in parts)
        scale = max(np.abs(part[name]).max() for part in parts)
        np.testing.assert_allclose(
            gradient, total, atol=(1e-5 if level != "float64" else 1e-13) * scale, err_msg=name
        )


@pytest.mark.parametrize("level", LEVELS)
def test_parallel_rays_show_the_same_from_any_distance(level):
    """A step of 8 along the camera's axis: other depths, and not a colour else; no gradient pulls along the
    axis."""
    scene, camera = scenes.random_scene(80, 3, 2, scale=0.3), scenes.ORTHOGRAPHIC["parallel_plain"]
    back = replace(camera, viewmat=camera.viewmat + np.outer((0, 0, 1, 0), (0, 0, 0, 8)))
    near, far = render(level, scene, camera, full=False), render(level, scene, back, full=False)
    close = {"rtol": 0, "atol": 2e-6 if level != "float64" else 1e-13}
    np.testing.assert_allclose(far["rgb"], near["rgb"], **close)
    np.testing.assert_allclose(far["depth"], near["depth"] + 8 * near["alpha"], rtol=1e-5)
    grads = backward(level, {name: image_weights(camera)[name] for name in ("rgb", "alpha")}, 80)
    assert not grads["means"][:, 2].any() and grads["means"][:, :2].any()
    fx, fy = camera.K.diagonal()[:2]
    pulled = grads["means2d"] * (fx, fy)
    np.testing.assert_allclose(grads["means"][:, :2], pulled, rtol=1e-5, atol=1e-6 * np.abs(pulled).max())


# --- order


@pytest.mark.parametrize("level", LEVELS)
def test_permutation_permutes(level):
    scene, masks = scenes.random_scene(80, 9, 1, scale=0.3), scenes.random_masks(80, 9)
    assert len(np.unique(scene.means[:, 2])) == 80
    order = np.random.default_rng(9).permutation(80)
    plain, shuffled = everything(level, scene, masks), everything(level, scene.select(order), masks[order])
    np.testing.assert_array_equal(np.sort(order[shuffled.pop("visible")]), plain.pop("visible"))
    for name in plain.keys() - set(IMAGES):
        plain[name] = plain[name][order]
    assert_same_bits(plain, shuffled)


@pytest.mark.parametrize("level", LEVELS)
def test_equal_depths_keep_index_order(level):
    """Red and blue at one depth: the one with the lower index is in front."""
    for first, second in ((0, 2), (2, 0)):
        scene = isotropic([(0, 0, 2)] * 2, opacity=0.6, dc=-0.5 / 0.28209479177387814)
        scene.sh[0, 0, first] = scene.sh[1, 0, second] = 0.5 / 0.28209479177387814
        image = render(level, scene, frontal(1, 1), background=(0, 0, 0))["rgb"][0, 0]
        np.testing.assert_allclose(image[[first, second]], [0.6, 0.24], rtol=1e-6)


@pytest.mark.parametrize("level", LEVELS)
def test_many_equal_depths_are_those_of_the_reference(level):
    scene, masks = scenes.equal_depths(60, 2, 0), scenes.random_masks(60, 2)
    image = render(level, scene, CAMERA, masks)
    expected = scenes.reference_render(scenes.leaves(scene, requires_grad=False), masks, CAMERA, BACKGROUND)
    np.testing.assert_allclose(image["rgb"], expected.rgb, atol=1e-6)
