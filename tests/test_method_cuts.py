"""Methods that cut by a rule of their own, in several passes or events: each rule against the float64
reference."""

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
from reference.rasterize import rotations
from short_runs import counts_of
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.methods import METHODS, popspa, reduced3dgs, speedy
from svrgs_addon.finetune.methods.gaussianpop import PASSES
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.penalties import EffectiveRank, OpacityGoal
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.finetune.viewed_scene import ViewedScene
from svrgs_addon.native.rasterizer import RenderOptions
from svrgs_addon.scene.gaussians import PARAMETERS
from weights_of_pixels import expected_dominance, expected_slopes, weights

# too small to be reduced
CAMERAS = [scenes.camera(29, 23), scenes.camera(31, 21, eye=(1.5, -1.0, -3.5), roll=20)]
OPTIONS = RenderOptions(background=BACKGROUND)


def faint_scene(count: int, seed: int):
    """No ray stops, so each Gaussian can be left out without an effect on the others."""
    scene = scenes.random_scene(count, seed, 1, scale=0.3)
    return replace(scene, opacity_logits=np.minimum(scene.opacity_logits, -1.0))


def picture(scene, camera, masks: np.ndarray) -> np.ndarray:
    """(H, W, 3) of the float64 reference, with the Gaussians of masks (N,)."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K, background = (
        torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K, BACKGROUND)
    )
    return reference.rasterize(
        *tensors, torch.tensor(masks.astype(np.float64)), viewmat, K, camera.width, camera.height, background
    ).rgb.numpy()


# --- gaussianpop


def removal_errors(scene, kept: np.ndarray) -> np.ndarray:
    """(N,) the squared error that each Gaussian's removal really causes among those kept, mean over values,
    sum over views."""
    errors = np.full(len(kept), -1.0)
    for i in np.flatnonzero(kept):
        without = kept.copy()
        without[i] = False
        errors[i] = sum(
            ((picture(scene, camera, kept) - picture(scene, camera, without)) ** 2).mean()
            for camera in CAMERAS
        )
    return errors


@pytest.mark.slow
def test_gaussianpop_removes_in_looks_what_really_changes_the_pictures_least():
    scene = faint_scene(24, 5)
    expected = np.ones(24, bool)
    once = np.argsort(-removal_errors(scene, expected), kind="stable")[:6]
    for look in range(1, PASSES + 1):
        errors = removal_errors(scene, expected)
        expected = np.isin(
            np.arange(24), np.argsort(-errors, kind="stable")[: round(24 * 0.25 ** (look / PASSES))]
        )
    double = ViewedScene(Model.of(scene, np.float64), CAMERAS, rasterizer("float64"), OPTIONS)
    kept = METHODS["gaussianpop"].cut(double, 6)
    assert kept.sum() == 6 and (kept == expected).all()
    assert not kept[once].all(), "one look would have kept the same: the test shows nothing"
    assert METHODS["gaussianpop"].cut(double, 100).all()


# --- methods with events


def run_of(method: str, steps: int, **changes) -> Run:
    scene = scenes.random_scene(200, 2, 1, scale=0.2)
    plan = replace(prune_settings(method, steps, 5), **changes)
    return Run(Model.of(scene), photographed(scene), plan, NativeEngine())


@pytest.mark.parametrize("target", [20, 34])
def test_speedy_falls_by_equal_ratios_at_the_published_fifths(target):
    """Without a target 30 % go at each of five cuts: at 15 000, 18 000, ... 27 000 of 30 000, which is 0,
    1/5, ... 4/5 of the rest."""
    assert prune_settings("speedy", 10, 0).method.share == pytest.approx(0.7**5)
    counts = counts_of(run_of("speedy", 50, target=target))
    left = [round(200 * (target / 200) ** (k / 5)) for k in range(1, 6)]
    assert counts == [left[0]] * 9 + [left[1]] * 10 + [left[2]] * 10 + [left[3]] * 10 + [target] * 16


def test_speedy_keeps_the_largest_slopes():
    """One cut, against autograd on the float64 reference (test_native_dominance.py)."""
    scene = faint_scene(30, 4)
    expected = sum(expected_slopes(scene, np.ones(30), camera) for camera in CAMERAS)
    found = scores.slopes(ViewedScene(Model.of(scene, np.float64), CAMERAS, rasterizer("float64"), OPTIONS))
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12 * expected.max())
    data = replace(photographed(scene), cameras=CAMERAS, train_indices=[0, 1])
    run = Run(
        Model.of(scene, np.float64),
        data,
        prune_settings("speedy", 10, 0, target=9, background=BACKGROUND),
        NativeEngine("float64"),
    )
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
    expected = {
        1: [],
        **{number: ["EffectiveRank"] for number in range(2, 31)},
        **dict.fromkeys((10, 20, 30), ["EffectiveRank", "OpacityGoal"]),
    }
    assert kinds == [expected.get(number, []) for number in range(2, 37)], "in the recovery there is none"


@pytest.mark.parametrize(("steps", "every"), [(5_000, 50), (3_000, 30), (60, 10)])
def test_popspa_pulls_at_the_published_spacing(steps, every):
    (phase,) = prune_settings("popspa", steps, 0).phases
    assert [n for n in range(1, steps + 1) if METHODS["popspa"]._pulls(phase, n)] == list(
        range(every, steps + 1, every)
    )


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
        popspa.project(model, np.array(stays, bool))
        term = OpacityGoal(5e-4, model.values[popspa.GOAL])
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
        goes = run.model.values[popspa.GOAL] + run.model.values[popspa.DUAL] == 0
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
        assert EffectiveRank().value(single, np) == pytest.approx(value, rel=2e-2)
        assert np.isfinite(EffectiveRank().grad(single)).all()


# --- minisplatting


def run_with(method: str, scene, **changes) -> Run:
    """A run in float64 with the two CAMERAS and BACKGROUND, for a single event."""
    data = replace(photographed(scene), cameras=CAMERAS, train_indices=[0, 1])
    run = Run(
        Model.of(scene, np.float64),
        data,
        prune_settings(method, 30, 0, background=BACKGROUND, **changes),
        NativeEngine("float64"),
    )
    run.target, run.method.count = changes.get("target", 0), scene.count
    return run


@pytest.mark.parametrize("by_area", [False, True])
def test_importance_is_that_of_mini_splatting(by_area):
    """Sums of alpha T of the float64 reference; by area their mean in each view in which the Gaussian
    dominates a pixel. Else 0."""
    scene = scenes.random_scene(60, 3, 1, scale=0.3)
    expected, dominated = np.zeros(60), np.zeros(60)
    for camera in CAMERAS:
        found, dominant = weights(scene, np.ones(60), camera), expected_dominance(scene, np.ones(60), camera)
        sums, pixels = found.sum(axis=0), (found > 0).sum(axis=0)
        expected += np.where(dominant > 0, sums / np.maximum(pixels, 1), 0) if by_area else sums
        dominated += dominant
    expected[dominated == 0] = 0
    viewed = ViewedScene(Model.of(scene, np.float64), CAMERAS, rasterizer("float64"), OPTIONS)
    found = scores.importance(viewed, by_area)
    assert 5 < (expected == 0).sum() < 55
    np.testing.assert_allclose(found, expected, rtol=1e-9, atol=1e-12)


@pytest.mark.parametrize("method", ["minisplatting", "minisplatting-outdoor"])
def test_minisplatting_draws_half_then_keeps_99_percent_of_the_importance(method):
    scene = scenes.random_scene(600, 3, 1, scale=0.1, opacity=-1.0)
    run = run_with(method, scene)
    value = scores.importance(run.viewed, method.endswith("outdoor"))
    drawn = run.method.event(run, 1)
    assert drawn.sum() == (value > 0).sum() // 2 and (value[drawn] > 0).all()
    assert (drawn == run.method.event(run, 1)).all(), "the same seed draws the same"
    run.model.keep(drawn)
    value = scores.importance(run.viewed, method.endswith("outdoor"))
    kept = run.method.event(run, 2)
    assert 0 < kept.sum() < len(kept) and value[kept].min() > value[~kept].max()
    lost = value[~kept].sum() / value.sum()
    assert lost <= 0.01 < lost + value[kept].min() / value.sum()


def test_minisplatting_draws_in_proportion_to_importance():
    many = np.array([3.0] * 10_000 + [1.0] * 10_000 + [0.0] * 10_000)
    drawn = scores.drawn(many, 1_000, [0, 5, 1])
    assert drawn.sum() == 1_000 and not drawn[20_000:].any()
    assert drawn[:10_000].sum() == pytest.approx(750, abs=5 * (1_000 * 0.75 * 0.25) ** 0.5)
    assert scores.drawn(many, 25_000, [0, 5, 1])[:20_000].all()


def test_minisplatting_draws_a_target_at_once():
    assert counts_of(run_of("minisplatting", 30, target=50)) == [50] * 35
    without = counts_of(run_of("minisplatting", 30))
    # at step 1 and after a third
    assert without[0] < 150 and without[8] == without[0] > without[9] == without[-1]


# --- efficientgs


def test_efficientgs_keeps_what_dominates_a_pixel():
    scene = scenes.random_scene(80, 3, 1, scale=0.3)
    dominated = sum(expected_dominance(scene, np.ones(80), camera) for camera in CAMERAS)
    sums = sum(weights(scene, np.ones(80), camera).sum(axis=0) for camera in CAMERAS)
    assert 10 < (dominated > 0).sum() < 70
    for done in (1, 2, 3):
        assert (
            run_with("efficientgs", scene).method.event(run_with("efficientgs", scene), done)
            == (dominated > 0)
        ).all()
    few, more = (dominated > 0).sum() - 5, (dominated > 0).sum() + 5
    ranked = np.lexsort((-sums, -dominated))
    for target, done, wanted in (
        (few, 1, dominated > 0),
        (few, 3, np.isin(np.arange(80), ranked[:few])),
        (more, 1, np.isin(np.arange(80), ranked[:more])),
    ):
        run = run_with("efficientgs", scene, target=int(target))
        assert (run.method.event(run, done) == wanted).all()


def test_efficientgs_cuts_at_the_published_fifths():
    counts = counts_of(run_of("efficientgs", 50, target=20))
    assert counts[0] < 200 and counts[18] > 20 and counts[19:] == [20] * 36


# --- reduced3dgs


def expected_redundancy(scene, cameras, neighbours: int = 30) -> np.ndarray:
    """Sphere by sphere, as the paper words it."""
    means, scales = scene.means.astype(np.float64), np.exp(scene.log_scales.astype(np.float64))
    R = rotations(torch.tensor(scene.quats, dtype=torch.float64)).numpy()
    n, counts, met = len(means), [], []
    for i in range(n):
        sides = []
        for camera in cameras:
            x, y, z = camera.viewmat[:3, :3] @ means[i] + camera.viewmat[:3, 3]
            u, v = camera.K[0, 0] * x / z + camera.K[0, 2], camera.K[1, 1] * y / z + camera.K[1, 2]
            if z > 0.2 and 0 <= u <= camera.width and 0 <= v <= camera.height:
                sides.append(z / (camera.K[0, 0] if camera.width > camera.height else camera.K[1, 1]))
        radius = min(sides, default=10_000.0) * 3**0.5 / 2
        nearest = np.argsort(np.linalg.norm(means - means[i], axis=1), kind="stable")[1 : neighbours + 1]
        met.append(
            [i]
            + [j for j in nearest if ((R[j].T @ (means[i] - means[j]) / (scales[j] + radius)) ** 2).sum() < 1]
        )
        counts.append(len(met[-1]))
    return np.array([min(counts[i] for i in range(n) if j in met[i]) for j in range(n)])


def test_redundancy_is_that_of_the_definition():
    scene = scenes.random_scene(120, 7, 0, spread=0.6, scale=0.15)
    found = reduced3dgs.redundancy(Model.of(scene), CAMERAS)
    np.testing.assert_array_equal(found, expected_redundancy(scene, CAMERAS))
    assert len(np.unique(found)) > 5 and found.min() >= 1
    assert (reduced3dgs.redundancy(Model.of(scenes.random_scene(1)), CAMERAS) == 1).all()


def test_the_faint_half_of_the_redundant_goes_and_the_faintest_go():
    redundancies = np.array([1] * 90 + [9] * 10)
    opacity = np.r_[np.linspace(0.01, 0.5, 90), np.linspace(0.2, 0.9, 10)]
    stays = reduced3dgs.stays(redundancies, opacity)
    lowest = np.flatnonzero(opacity < np.quantile(opacity, 0.03))
    # below the lower median of ten: four
    assert sorted(np.flatnonzero(~stays)) == sorted({*lowest, *range(90, 94)})
    # a redundancy of 3 is none, and an opacity of 0.05 is enough
    assert reduced3dgs.stays(np.full(100, 3), np.full(100, 0.9)).all()


@pytest.mark.parametrize("target", [0, 40])
def test_reduced3dgs_cuts_in_thirteen_events(target):
    counts = counts_of(run_of("reduced3dgs", 150, target=target))
    fell = [k + 1 for k in range(1, 155) if counts[k] < counts[k - 1]]
    assert counts[0] < 200 and set(fell) <= {*range(10, 121, 10), 100}
    if target:
        assert fell == list(range(10, 121, 10)) and counts[-1] == target


def test_reduced3dgs_penalises_the_opacity_of_what_the_view_sees():
    """0.001 times its mean: the gradient reaches the visible Gaussians alone, in both engines
    (test_methods.py runs them side by side)."""
    run = run_of("reduced3dgs", 150)
    run._prepare(run.plan.phases[0], 1)
    step = run._step(
        run.plan.phases[0],
        1,
        run.dataset.cameras[0],
        np.ascontiguousarray(run.dataset.pictures[0] / 255, np.float32),
    )
    run.model.means[:50] += 100.0  # out of the view
    before = run.model.opacity_logits.copy()
    result = run.engine.step(run.model, step)
    opacity = 1 / (1 + np.exp(-before[result.visible].astype(np.float64)))
    assert result.penalty == pytest.approx(1e-3 * opacity.mean(), rel=1e-5) and len(result.visible) <= 150
    changed = run.model.opacity_logits != before
    assert changed[result.visible].all() and not np.delete(changed, result.visible).any()


# --- rdo


def test_rdo_removes_once_at_the_end():
    """The gate is that of compact3dgs, which removes at its events too."""
    phases = tuple(
        replace(phase, prune_every=phase.active and 10) for phase in prune_settings("rdo", 40, 5).phases
    )
    found = []
    for method in ("rdo", "compact3dgs"):
        run = run_of(method, 40, phases=phases)
        run.advance()
        run.model.values[MASK][:100] = -6.0  # closed
        found.append(counts_of(run))
    assert found == [[200] * 38 + [100] * 6, [200] * 8 + [100] * 36]
