"""Methods that cut by a rule of their own, in several looks or events: each rule against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from native_helpers import BACKGROUND, rasterizer
from pictures import photographed
from plans import prune_settings, train_settings
from reference import rasterize as reference
from svrgs_addon.finetune import admm, scores
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, popspa, speedy
from svrgs_addon.finetune.methods.gaussianpop import LOOKS
from svrgs_addon.finetune.model import PARAMETERS, Model
from svrgs_addon.finetune.penalties import EffectiveRank
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.native import RenderOptions
from weights_of_pixels import expected_slopes

CAMERAS = [scenes.camera(29, 23), scenes.camera(31, 21, eye=(1.5, -1.0, -3.5), roll=20)]  # too small to be reduced
OPTIONS = RenderOptions(background=BACKGROUND)


def faint_scene(count: int, seed: int):
    """No ray stops, so each Gaussian can be left out without an effect on the others."""
    scene = scenes.random_scene(count, seed, 1, scale=0.3)
    return replace(scene, opacity_logits=np.minimum(scene.opacity_logits, -1.0))


def picture(scene, camera, masks: np.ndarray) -> np.ndarray:
    """(H, W, 3) of the float64 reference, with the Gaussians of masks (N,)."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K, background = (torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K, BACKGROUND))
    return reference.rasterize(*tensors, torch.tensor(masks.astype(np.float64)), viewmat, K, camera.width, camera.height, background).rgb.numpy()


# --- gaussianpop


def removal_errors(scene, kept: np.ndarray) -> np.ndarray:
    """(N,) the squared error that each Gaussian's removal really causes among those kept, mean over values, sum over views."""
    errors = np.full(len(kept), -1.0)
    for i in np.flatnonzero(kept):
        without = kept.copy()
        without[i] = False
        errors[i] = sum(((picture(scene, camera, kept) - picture(scene, camera, without)) ** 2).mean() for camera in CAMERAS)
    return errors


def test_gaussianpop_removes_in_looks_what_really_changes_the_pictures_least():
    scene = faint_scene(24, 5)
    expected = np.ones(24, bool)
    once = np.argsort(-removal_errors(scene, expected), kind="stable")[:6]
    for look in range(1, LOOKS + 1):
        errors = removal_errors(scene, expected)
        expected = np.isin(np.arange(24), np.argsort(-errors, kind="stable")[: round(24 * 0.25 ** (look / LOOKS))])
    r = rasterizer("float64")
    double = Model.of(scene, np.float64)
    kept = METHODS["gaussianpop"].cut(double, CAMERAS, r, OPTIONS, 6)
    assert kept.sum() == 6 and (kept == expected).all()
    assert not kept[once].all(), "one look would have kept the same: the test shows nothing"
    assert METHODS["gaussianpop"].cut(double, CAMERAS, r, OPTIONS, 100).all()


# --- methods with events


def counts_of(run: Run) -> list[int]:
    """Gaussians after each step."""
    counts = []
    while not run.finished:
        run.advance()
        counts.append(run.model.count)
    run.close()
    return counts


def run_of(method: str, steps: int, **changes) -> Run:
    scene = scenes.random_scene(200, 2, 1, scale=0.2)
    return Run(Model.of(scene), photographed(scene), replace(prune_settings(method, steps, 5), **changes), NativeEngine())


@pytest.mark.parametrize("target", [20, 34])
def test_speedy_falls_by_equal_ratios_at_the_published_fifths(target):
    """Without a target 30 % go at each of five cuts: at 15 000, 18 000, ... 27 000 of 30 000, which is 0, 1/5, ... 4/5 of the rest."""
    assert prune_settings("speedy", 10, 0).method.share == pytest.approx(0.7**5)
    counts = counts_of(run_of("speedy", 50, target=target))
    left = [round(200 * (target / 200) ** (k / 5)) for k in range(1, 6)]
    assert counts == [left[0]] * 9 + [left[1]] * 10 + [left[2]] * 10 + [left[3]] * 10 + [target] * 16


def test_speedy_keeps_the_largest_slopes():
    """One cut, against autograd on the float64 reference (test_native_dominance.py)."""
    scene = faint_scene(30, 4)
    expected = sum(expected_slopes(scene, np.ones(30), camera) for camera in CAMERAS)
    found = scores.slopes(Model.of(scene, np.float64), CAMERAS, rasterizer("float64"), OPTIONS)
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * expected.max())
    data = replace(photographed(scene), cameras=CAMERAS, train_indices=[0, 1])
    run = Run(Model.of(scene, np.float64), data, prune_settings("speedy", 10, 0, target=9, background=BACKGROUND), NativeEngine("float64"))
    run.target, run.method.count = 9, 30
    assert (run.method.event(run, 5) == scores.top(expected, 9)).all()


def test_speedy_prunes_softly_while_training_densifies():
    """80 % at 2/5, 3/5 and 4/5 of the steps with densification: published 6 000, 9 000, 12 000 of 15 000."""
    rule = Densify(start=5, until=100, every=10, reset_every=1_000, gradient=1e9)  # nothing grows
    settings = train_settings("speedy", 200, 0, densify=rule, target=2)
    scene = scenes.random_scene(500, 2, 1, scale=0.2)
    run = Run(Model.of(scene), photographed(scene), settings, NativeEngine())
    counts = counts_of(run)
    soft = [k for k in range(1, 99) if counts[k] < counts[k - 1]]
    assert [k + 1 for k in soft] == [40, 60, 80] and [counts[k] for k in soft] == [100, 20, 4]
    published = METHODS["speedy"].train_phases(30_000, 0, Densify(), 0)[0].densify
    assert [share * published.until for share in speedy.SOFT_CUTS] == [6_000, 9_000, 12_000]


# --- popspa


def test_popspa_cuts_twice_by_equal_ratios_and_has_its_terms_in_between():
    counts = counts_of(run_of("popspa", 30, target=50))
    assert counts == [round((200 * 50) ** 0.5)] * 29 + [50] * 6
    run, kinds = run_of("popspa", 30, target=50), []
    while not run.finished:
        phase, number = run.phase()
        run.advance()
        step = run._step(*run.phase(), run.dataset.cameras[0], None) if not run.finished else None
        kinds.append([type(penalty).__name__ for penalty in step.penalties] if step else [])
    run.close()
    expected = {1: [], **{number: ["EffectiveRank"] for number in range(2, 31)}, **dict.fromkeys((10, 20, 30), ["EffectiveRank", "OpacityGoal"])}
    assert kinds == [expected.get(number, []) for number in range(2, 37)], "in the recovery there is none"


@pytest.mark.parametrize(("steps", "every"), [(5_000, 50), (3_000, 30), (60, 10)])
def test_popspa_pulls_at_the_published_spacing(steps, every):
    (phase,) = prune_settings("popspa", steps, 0).phases
    assert [n for n in range(1, steps + 1) if METHODS["popspa"]._pulls(phase, n)] == list(range(every, steps + 1, every))


def test_admm_is_that_of_gaussianspa():
    """Proxy and dual of five Gaussians over three projections, written out; the opacities move in between."""
    model = Model.of(scenes.random_scene(5, 1, 0), np.float64)
    z, u = None, np.zeros(5)
    for stays in ([1, 1, 0, 0, 1], [0, 1, 0, 1, 1], [1, 1, 0, 1, 0]):
        o = 1 / (1 + np.exp(-model.opacity_logits))
        first = z is None
        z = np.array([o[i] + u[i] if stays[i] else 0.0 for i in range(5)])
        if not first:
            u = u + o - z
        admm.project(model, np.array(stays, bool))
        term = admm.pull(model, 5e-4)
        np.testing.assert_allclose(term.goal, z - u, atol=1e-15)
        assert term.value(model.opacity_logits, np) == pytest.approx(0.5 * 5e-4 * ((o - z + u) ** 2).sum())
        model.opacity_logits[:] += np.random.default_rng(len(stays)).normal(0, 0.5, 5)


def test_popspa_fades_what_is_to_go():
    """The Gaussians outside the target lose opacity against a run without the pull."""
    means = []
    for rho in (0.0, 0.5):
        run = run_of("popspa", 60, target=50)
        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(popspa, "RHO", rho)
            while run.iteration < 59:
                run.advance()
        run.close()
        goes = run.model.values[admm.GOAL] + run.model.values[admm.DUAL] == 0
        means.append((1 / (1 + np.exp(-run.model.opacity_logits[goes]))).mean())
        assert goes.sum() == 50
    assert means[1] < 0.8 * means[0]


def test_the_effective_rank_is_that_of_its_definition():
    scales = np.array([[1, 1, 1], [3, 3, 1e-6], [5, 1e-5, 1e-5], [2, 1, 0.5], [1e-30, 1e-31, 1e-31]])
    p = scales**2 / (scales**2).sum(axis=1, keepdims=True)
    erank = np.exp(-(p * np.log(np.maximum(p, 1e-300))).sum(axis=1))
    np.testing.assert_allclose(erank[:2], [3, 2], rtol=1e-9)
    wanted = 0.01 * np.maximum(-np.log(erank - 1 + 1e-7), 0) + scales.min(axis=1)
    for row, value in zip(scales, wanted, strict=True):
        assert EffectiveRank().value(np.log(row)[None], np) == pytest.approx(value, rel=1e-6)
        single = np.log(row)[None].astype(np.float32)
        assert EffectiveRank().value(single, np) == pytest.approx(value, rel=2e-2) and np.isfinite(EffectiveRank().grad(single)).all()
