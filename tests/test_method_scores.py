"""Scores that rank: against the float64 reference, and that the highest stay."""

from __future__ import annotations

import functools
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from native_helpers import LEVELS, rasterizer, typed
from pictures import photographed
from plans import RANKED, train_settings
from reference import rasterize as reference
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, lightgaussian, method_named, pup
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.rasterizer import RenderOptions
from svrgs_addon.scene.gaussians import PARAMETERS

# of torch itself, where it differentiates forward
pytestmark = pytest.mark.filterwarnings("ignore:.torch.jit.script")
BACKGROUND = (0.2, 0.5, 0.9)


def blended(scene, camera) -> tuple[np.ndarray, np.ndarray]:
    """(alpha, T) (P, N) of the float64 reference, 0 where a Gaussian is not blended."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K = (torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K))
    degree = round(scene.sh.shape[1] ** 0.5) - 1
    splats = reference.project(*tensors, viewmat, K, camera.width, camera.height, degree, False)
    alpha, hit = reference.alphas(splats, reference.pixel_centres(camera.width, camera.height))
    T = reference.transmittance(alpha, torch.ones(alpha.shape[1], dtype=torch.float64))
    live = hit & torch.cumprod((T[:, 1:] >= reference.T_MIN).long(), 1).bool()
    full = np.zeros((2, len(alpha), scene.count))
    full[0][:, splats.index.numpy()] = torch.where(live, alpha, 0.0).numpy()
    full[1][:, splats.index.numpy()] = torch.where(live, T[:, :-1], 0.0).numpy()
    return full[0], full[1]


CAMERAS = [scenes.camera(29, 23), scenes.camera(33, 21, eye=(1.5, -1.0, -3.5), roll=20)]


@pytest.mark.parametrize("level", LEVELS)
def test_scores_are_those_of_the_reference(level):
    """Sum and maximum of alpha T, and LightGaussian's sum of opacity T. Worst seen: 1.7e-7 of the largest in
    float32, 3e-16 in float64."""
    r = rasterizer(level)
    scene = typed(scenes.random_scene(40, 6, 1, scale=0.3), r.dtype)
    scene.count = 40
    expected = np.zeros((3, 40))
    for camera in CAMERAS:
        alpha, T = blended(scene, camera)
        opacity = 1 / (1 + np.exp(-scene.opacity_logits.astype(np.float64)))
        expected[0] += (alpha * T).sum(axis=0)
        expected[1] = np.maximum(expected[1], (alpha * T).max(axis=0))
        expected[2] += opacity * T.sum(axis=0)
    viewed = ViewedScene(scene, CAMERAS, r, RenderOptions())
    found = (
        METHODS["contribution"].score(viewed),
        METHODS["max-contribution"].score(viewed),
        scores.significance(viewed),
    )
    bounds = (1e-13, 1e-7, 1e-13) if level == "float64" else (2e-6,) * 3  # the maximum is kept in float32
    for value, wanted, bound in zip(found, expected, bounds, strict=True):
        np.testing.assert_allclose(value, wanted, rtol=0, atol=bound * wanted.max())


def test_lightgaussians_volume_counts_for_little_and_is_clamped():
    log_scales = np.log(np.cbrt(np.arange(1, 101.0)))[:, None].repeat(3, axis=1)
    factor = lightgaussian.volume_factor(log_scales)  # volumes 1 ... 100; the 90th counts as 1
    np.testing.assert_allclose(factor, np.minimum(np.arange(1, 101) / 90, 1) ** 0.1, rtol=1e-12)
    assert len(lightgaussian.volume_factor(log_scales[:0])) == 0


# --- pup


VIEWS = {"front": CAMERAS[0], "rolled": CAMERAS[1], "inside": scenes.camera(24, 40, eye=(0.3, 0.2, -0.9))}


def small_scene(dtype):
    """30 Gaussians of one colour each, as what turns with the view is no part of the sensitivity; one is
    behind the cameras in front."""
    scene = typed(scenes.random_scene(30, 3, 0, scale=0.3), dtype)
    scene.count = 30
    scene.means[7] = (0, 0, -50)
    return scene


@functools.cache
def expected_sensitivities(view: str) -> np.ndarray:
    return sensitivities(small_scene(np.float64), VIEWS[view])


def sensitivities(scene, camera) -> np.ndarray:
    """H (N, 6, 6) by brute force: the reference's Jacobian of every colour in every mean and log-scale."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K, background = (
        torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K, BACKGROUND)
    )

    def colours(means, log_scales):
        ones = torch.ones(scene.count, dtype=torch.float64)
        return reference.rasterize(
            means, log_scales, *tensors[2:], ones, viewmat, K, camera.width, camera.height, background
        ).rgb.reshape(-1)

    forward = {"strategy": "forward-mode", "vectorize": True}  # ten times as many colours as parameters
    both = torch.autograd.functional.jacobian(colours, tuple(tensors[:2]), **forward)
    g = torch.cat(both, dim=2)  # (colours, N, 6)
    return torch.einsum("pni,pnj->nij", g, g).numpy()


@pytest.mark.slow
@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("view", VIEWS)
def test_sensitivities_are_those_of_the_reference(level, view):
    """Worst seen, of each matrix's largest value: 3.9e-14 in float64, 2.5e-5 in float32."""
    r, camera = rasterizer(level), VIEWS[view]
    scene, expected = small_scene(r.dtype), expected_sensitivities(view)
    r.forward(scene, camera, RenderOptions(background=BACKGROUND), outputs=())
    ids = r.visible()
    found = np.zeros((30, 6, 6))
    upper = pup._view_part(r.moments(), pup.jacobians(scene, camera, ids))
    found[ids[:, None], pup._UPPER[0], pup._UPPER[1]] = upper
    found[ids[:, None], pup._UPPER[1], pup._UPPER[0]] = upper
    scale = np.abs(expected).max(axis=(1, 2))
    assert (scale > 0).sum() > 10
    assert np.abs(found[scale == 0]).max(initial=0) == 0
    worst = (np.abs(found - expected).max(axis=(1, 2))[scale > 0] / scale[scale > 0]).max()
    assert worst < (1e-12 if level == "float64" else 2e-4)


@pytest.mark.slow
def test_pup_ranks_by_the_determinant_over_all_views():
    scene = small_scene(np.float64)
    expected = sum(map(expected_sensitivities, ("front", "rolled")))
    found = pup.log_determinants(
        ViewedScene(scene, CAMERAS, rasterizer("float64"), RenderOptions(background=BACKGROUND))
    )
    sign, log_det = np.linalg.slogdet(expected)
    sure = (sign > 0) & (np.linalg.cond(expected) < 1e10)
    assert sure.sum() > 10 and found[7] == -np.inf
    np.testing.assert_allclose(found[sure], log_det[sure], rtol=1e-5, atol=1e-4)


@pytest.mark.parametrize("level", LEVELS)
def test_moments_leave_gradients_and_scores_alone(level):
    """And are the same every time."""
    r = rasterizer(level)
    scene = typed(scenes.random_scene(40, 6, 1, scale=0.3), r.dtype)
    ones = np.ones((CAMERAS[0].height, CAMERAS[0].width, 3), r.dtype)
    r.forward(scene, CAMERAS[0])
    plain = {name: g.copy() for name, g in r.backward({"rgb": ones}).items()}
    r.forward(scene, CAMERAS[0])
    first, second = r.moments(), r.moments()
    assert first.tobytes() == second.tobytes() and first.shape == (len(r.visible()), 12)
    after = r.backward({"rgb": ones})
    assert all((after[name] == g).all() for name, g in plain.items())


# their cuts: test_method_cuts.py
@pytest.mark.parametrize("method", [name for name in RANKED if name not in ("gaussianpop", "merge")])
def test_methods_that_rank_keep_the_highest(method):
    scene = scenes.random_scene(60, 4, 1, scale=0.2)
    dataset = photographed(scene)
    rule = Densify(until=0)
    settings = replace(train_settings(method, 1, 0, densify=rule, target=25), spatial_order=False)
    run = Run(Model.of(scene), dataset, settings, NativeEngine())
    run.advance()
    run.close()
    after = Model.of(scene)
    moved = Run(after, dataset, replace(settings, method=method_named("3dgs")), NativeEngine())
    moved.advance()
    moved.close()
    score = METHODS[method].score(replace(moved.viewed, cameras=dataset.cameras))
    assert sorted(run.model.origin) == sorted(np.argsort(-score, kind="stable")[:25])


def test_scene_is_accepted_as_well_as_model():
    viewed = ViewedScene(scenes.random_scene(20, 4, 1), CAMERAS, rasterizer(LEVELS[0]), RenderOptions())
    for method in set(RANKED) - {"merge"}:
        assert METHODS[method].score(viewed).shape == (20,)


def test_pup_looks_at_a_quarter_of_the_size(monkeypatch):
    scene, camera = scenes.random_scene(60, 1, 0, scale=0.3), scenes.camera(256, 192)
    viewed = lambda view: ViewedScene(scene, [view], rasterizer("scalar"), RenderOptions())
    found = pup.log_determinants(viewed(camera))
    monkeypatch.setattr(pup, "REDUCTION", 1)
    assert np.isfinite(found).any() and (pup.log_determinants(viewed(camera.reduced(4))) == found).all()
