"""A view that is not kept for gradients and statistics gives the same picture, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

import scenes
from native_helpers import CAMERA, LEVELS, assert_same_bits, rasterizer, typed
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import COUNTS, IMAGES, Rasterizer, RenderOptions
from svrgs_addon.system.errors import NativeError

OUTPUTS = (*IMAGES, *COUNTS)


def views(level: str, mask_kind: str = "svr", camera=CAMERA, count: int = 60, **more):
    """The same view, kept and not."""
    r = rasterizer(level)
    scene = typed(scenes.random_scene(count, 1, 2, scale=0.3), r.dtype)
    masks = scenes.random_masks(count, 1).astype(np.uint8)
    draw = lambda only: r.forward(
        scene, camera, RenderOptions(mask_kind=mask_kind, picture_only=only), masks, OUTPUTS, **more
    )
    return draw(False), draw(True)


@pytest.mark.parametrize("mask_kind", library.mask_kinds())
@pytest.mark.parametrize("level", LEVELS)
def test_the_picture_is_the_same(level, mask_kind):
    kept, only = views(level, mask_kind)
    assert kept["rgb"].any()
    assert_same_bits(only, kept)


def test_the_picture_is_the_same_on_any_number_of_threads_and_with_depth_limits():
    camera = scenes.camera(150, 100)
    limit = np.full((100, 150), 4, np.float32)
    try:
        for threads in (1, 2, 7):
            library.set_threads(threads)
            for more in ({}, {"depth_limit": limit}):
                kept, only = views(library.best_level(), camera=camera, count=400, **more)
                assert_same_bits(only, kept)
    finally:
        library.set_threads(0)


def test_the_view_has_no_gradients_and_no_statistics():
    r, scene = Rasterizer(), scenes.random_scene(50, 1, 1)
    arrays, ones = typed(scene, r.dtype), np.ones((27, 40), r.dtype)
    sums = np.zeros(50), np.zeros(50, np.float32), np.zeros(50, np.int64)
    r.forward(arrays, CAMERA, RenderOptions(), outputs=("alpha",))
    visible = r.visible()
    r.forward(arrays, CAMERA, RenderOptions(picture_only=True), outputs=("alpha",))
    for call in (
        lambda: r.backward({"alpha": ones}, ("masks",)),
        lambda: r.add_scores(*sums),
        lambda: r.work(count_pixels=True),
    ):
        with pytest.raises(NativeError, match="svrgs_forward"):
            call()
    assert not sums[0].any() and r.work()["visible"] == len(visible)
    np.testing.assert_array_equal(r.visible(), visible)
    r.forward(arrays, CAMERA, RenderOptions(), outputs=("alpha",))
    assert r.backward({"alpha": ones}, ("masks",))["masks"].any()
