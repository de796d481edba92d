"""Fewer Gaussians for coarse pictures."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.render import thinning
from svrgs_addon.render.metrics.measures import psnr
from svrgs_addon.render.thinning import GROUP, Thinning, thinned
from svrgs_addon.scene.morton_order import morton_order
from svrgs_bench.scenes import orbit_camera, room


@pytest.fixture(scope="module")
def scene():
    scene = room(120_001, 1)
    return scene.select(morton_order(scene.means))


def picture(scene, camera) -> np.ndarray:
    return Rasterizer().forward(scene, camera, RenderOptions())["rgb"]


def test_coarse_pictures_of_a_quarter_of_the_gaussians_are_as_like_the_exact_one(scene):
    camera = orbit_camera(640, 360, 0.1)
    exact = picture(scene, camera).reshape(45, 8, 80, 8, 3).mean(axis=(1, 3))
    few = thinned(scene)
    assert few.count == 30_001 and few.sh_degree == 1
    coarse, thin, plain = (
        picture(one, camera.reduced(8))
        for one in (scene, few, scene.select(np.arange(0, scene.count, GROUP)))
    )
    assert psnr(thin, exact) > psnr(coarse, exact) - 0.5 and psnr(thin, exact) > psnr(plain, exact) + 2, [
        psnr(one, exact) for one in (coarse, thin, plain)
    ]


def test_one_for_several_is_as_large_as_they_are_in_their_mean_colour():
    scene = replace(
        room(4, 0),
        log_scales=np.log(np.full((4, 3), 0.1, np.float32)),
        opacity_logits=np.zeros(4, np.float32),
    )
    few = thinned(scene)
    assert few.count == 1 and (few.means[0] == scene.means[0]).all()
    np.testing.assert_allclose(np.exp(few.log_scales), 0.2, rtol=1e-5)
    np.testing.assert_allclose(few.sh[0], scene.sh.mean(axis=0), rtol=1e-5)
    faint = replace(scene, opacity_logits=np.array([-20, 1, -20, -20], np.float32))
    assert (thinned(faint).means[0] == scene.means[1]).all()
    np.testing.assert_allclose(thinned(faint).log_scales, scene.log_scales[:1], atol=1e-4)


def test_parts_and_remainders_have_no_seams(scene, monkeypatch):
    whole = thinned(scene)
    monkeypatch.setattr(thinning, "PART", 1000)
    parts = thinned(scene)
    assert all(
        (getattr(whole, name) == getattr(parts, name)).all()
        for name in ("means", "log_scales", "quats", "opacity_logits", "sh")
    )


def test_only_where_many_are_seen_fewer_are_drawn(scene, monkeypatch):
    monkeypatch.setattr(thinning, "MAX_SEEN", 20_000)
    choice, rasterizer, drawn = Thinning(scene), Rasterizer(), []
    near = orbit_camera(160, 90, 0.1)
    K = near.K.copy()
    K[:2, :2] *= 40
    for camera in (near, near, near, replace(near, K=K), replace(near, K=K), near):
        drawn.append(choice.draws())
        rasterizer.forward(drawn[-1], camera, RenderOptions())
        choice.drew(drawn[-1], rasterizer)
        choice.wait()
    assert [one is scene for one in drawn] == [True, False, False, False, True, True]
    assert choice.draws() is drawn[1], "made once"
