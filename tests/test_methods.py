"""Every method: its schedule, what it penalises, what it drops, and that a stopped run goes on bit for bit."""

from __future__ import annotations

import functools
import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from native_helpers import LEVELS, rasterizer, typed
from pictures import photographed
from plans import plan_of, prune_settings, train_settings
from reference import rasterize as reference
from svrgs_addon.errors import SceneError
from svrgs_addon.finetune import checkpoint, scores, sensitivity
from svrgs_addon.finetune.engine import NativeEngine, mask_logit_rows
from svrgs_addon.finetune.methods import FORMER_NAMES, METHODS, compact3dgs, lightgaussian, method_named, opacity_pressure, paper_method
from svrgs_addon.finetune.model import MASK, PARAMETERS, Model
from svrgs_addon.finetune.penalties import MeanExistence, OpacityPressure
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Densify, Phase, Rates
from svrgs_addon.finetune.torch_engine import TorchEngine
from svrgs_addon.native import RenderOptions
from svrgs_addon.scene import Scene

LEARNED = [name for name, method in METHODS.items() if method.prunes and not method.ranks]
FAMILIES = ("pressure", "svr", "saliency", "maskgs-alpha", "compact3dgs", "gns", "lightgaussian", "pup", "3dgs")  # one of each file, and pup
RANKED = [name for name, method in METHODS.items() if method.ranks]
BACKGROUND = (0.2, 0.5, 0.9)


def to_the_end(run: Run) -> Run:
    while not run.finished:
        run.advance()
    run.close()
    return run


def state(run: Run) -> dict:
    parts = {"values": run.model.values, "moments": run.model.moments, "": {"origin": run.model.origin}}
    arrays = {f"{part} {name}": array.tobytes() for part, found in parts.items() for name, array in found.items()}
    return arrays | {"method": run.method.state(), "target": run.target, "loss": run.loss}


def grown_run(method: str, engine=None, dtype=np.float32, **changes) -> Run:
    """From a disturbed scene of 150: clones, splits, an opacity reset, pruning to about a third, recovery."""
    truth = scenes.random_scene(150, 2, 1, scale=0.2)
    rng = np.random.default_rng(5)
    arrays = {name: (getattr(truth, name) + rng.normal(0, 0.06, getattr(truth, name).shape)).astype(np.float32) for name in PARAMETERS}
    rule = Densify(start=5, until=31, every=10, reset_every=25, gradient=2e-5, small=0.1)
    share = 0.0 if method == "3dgs" else 0.35
    settings = train_settings(method, 60, 10, densify=rule, seed=4, share=share)
    start = {} if method == "compact3dgs" else {"mask_init": 1.0}  # undecided masks, so that events bite
    phases = tuple(replace(phase, prune_every=phase.prune_every and 10) for phase in settings.phases)
    return Run(Model.of(replace(truth, **arrays), dtype), photographed(truth), replace(settings, phases=phases, **start, **changes), engine or NativeEngine())


# --- the registry


def test_an_unknown_method_is_one_sentence():
    with pytest.raises(SceneError, match="method 'magic' is unknown: choose one of pressure, svr, .*3dgs$"):
        method_named("magic")


def test_methods_of_two_runs_do_not_share_their_state():
    first, second = method_named("gns"), method_named("gns")
    first.factor = 7.0
    assert (second.factor, METHODS["gns"].factor) == (1.0, 1.0)


def test_paper_chooses_the_printed_settings_to_the_letter():
    """L1 + (1 - SSIM) with weights of 1, lambda_F 1e-4, F along the whole ray, 10 draws at each densification and every 1000 steps, no first cut."""
    paper = paper_method()
    assert (paper.mask_kind, paper.lambda_f, paper.first_cut) == ("svr", 1e-4, False)
    plan = train_settings("svr-paper", 30_000, 5_000)
    assert (plan.l1_weight, plan.ssim_weight) == (1.0, 1.0)
    assert (plan.lambda_f, plan.full, plan.mask_init, plan.draws) == (1e-4, True, 9.0, 10)
    assert plan.phases[0].prune_every == 1_000 and plan.phases[1].steps == 5_000
    svr = train_settings("svr", 30_000, 5_000)
    assert (svr.l1_weight, svr.ssim_weight, svr.method.first_cut) == (0.8, 0.2, True) and svr.phases == plan.phases


def test_names_and_menu_numbers_are_each_one_method_s():
    """Numbers are stored in .blend files; those of the first schema keep their methods."""
    assert len({method.number for method in METHODS.values()}) == len(METHODS)
    first = ("svr", "svr-mask", "svr-self", "svr-even", "svr-a", "svr-b", "svr-worth", "maskgs", "maskgs-alpha", "maskgs-beta", "maskgs-gamma")
    first += ("compact3dgs", "gns", "lightgaussian", "opacity", "contribution", "max-contribution", "pup")
    assert [METHODS[FORMER_NAMES.get(name, name)].number for name in first] == list(range(len(first)))
    assert all(method.help and method.name == name for name, method in METHODS.items())


def test_a_weight_the_method_does_not_have_is_refused():
    with pytest.raises(SceneError, match="no term with the weight lambda-m"):
        prune_settings("svr", 10, 10, lambda_m=1e-3)
    assert prune_settings("compact3dgs", 10, 10, lambda_m=1e-3).lambda_m == 1e-3


# --- schedules


def test_a_shorter_schedule_keeps_the_spacing_of_what_needs_views():
    for share, (start, until, every, resets) in {1: (500, 15_000, 100, 3_000), 0.1: (500, 1_500, 100, 3_000), 0.02: (100, 300, 100, 3_000)}.items():
        train, recover = train_settings("svr", 30_000, 5_000, schedule=share).phases
        rule = train.densify
        assert (train.steps, recover.steps) == (30_000 * share, 5_000 * share)
        assert (rule.start, rule.until, rule.every, rule.reset_every) == (start, until, every, resets)
        assert train.rates.mask == pytest.approx(train_settings("svr", 30_000, 5_000).phases[0].rates.mask / share)


def test_maskgs_counts_in_its_window():
    """Alpha: 19 000 to 20 000 of 30 000, both included, and the same share of shorter runs; masks are drawn all the time."""
    for steps, inside, outside in ((30_000, (19_000, 19_500, 20_000), (1, 18_999, 20_001)), (300, (190, 200), (189, 201))):
        run = Run(Model.of(scenes.random_scene(5)), photographed(scenes.random_scene(5)), train_settings("maskgs-alpha", steps, 0), None)
        run.method.prepare(run, run.settings.phases[0], 1)
        weights = [run.method.terms(run, run.settings.phases[0], number)["lambda_m"] for number in (*inside, *outside)]
        assert weights == [0.1] * len(inside) + [0.0] * len(outside)
        assert "masks" in run.method.terms(run, run.settings.phases[0], 1)


@pytest.mark.parametrize(("method", "weight"), [("maskgs", 5e-4), ("maskgs-beta", 5e-4), ("maskgs-gamma", 1e-3)])
def test_the_other_maskgs_count_all_the_time(method, weight):
    run = Run(Model.of(scenes.random_scene(5)), photographed(scenes.random_scene(5)), train_settings(method, 300, 0), None)
    run.method.prepare(run, run.settings.phases[0], 1)
    assert {run.method.terms(run, run.settings.phases[0], number)["lambda_m"] for number in (1, 150, 300)} == {weight}


def test_maskgs_after_training_decides_once():
    """0.1 inside the bracket that 0.2 multiplies; no events; rates fade twelve times."""
    settings = prune_settings("maskgs", 5_000, 0)
    (phase,) = settings.phases
    assert settings.lambda_m == pytest.approx(0.02) and phase.prune_every == 0
    assert phase.rates.at(5_000, 1.0)["sh"] == pytest.approx(2.5e-3 * 0.95**12)
    assert prune_settings("maskgs", 500, 0).phases[0].rates.at(500, 1.0)["sh"] == pytest.approx(2.5e-3 * 0.95**12)
    scene = scenes.random_scene(60)
    short = replace(prune_settings("maskgs", 30, 0), mask_init=-1.0)  # ten draws would have missed some
    run = Run(Model.of(scene), photographed(scene), replace(short, target=40), NativeEngine())
    counts = []
    while not run.finished:
        run.advance()
        counts.append(run.model.count)
    run.close()
    assert counts == [60] * 29 + [40]


def test_gns_presses_in_the_last_8_of_23_parts_of_training():
    train, press, recover = train_settings("gns", 23_000, 100).phases
    assert [(phase.name, phase.steps, phase.active) for phase in (train, press, recover)] == [
        ("train", 15_000, False),
        ("press", 8_000, True),
        ("recover", 100, False),
    ]
    assert press.rates.at(0, 1.0)["means"] == pytest.approx(Rates().at(15_000, 1.0)["means"])
    assert press.rates.at(1, 1.0)["opacity_logits"] == pytest.approx(0.1)


@pytest.mark.parametrize("method", RANKED)
def test_methods_that_rank_only_recover_a_trained_scene(method):
    assert [phase.name for phase in prune_settings(method, 3_000, 100).phases] == ["recover"]
    assert [phase.active for phase in train_settings(method, 3_000, 100).phases] == [True, False]


# --- a share of what has grown


@pytest.mark.parametrize("method", [*RANKED, *LEARNED])
def test_a_share_counts_from_the_end_of_densification(method):
    run, grown = grown_run(method), 0
    while not run.finished:
        if run.iteration == 30:
            grown = run.model.count
        run.advance()
    run.close()
    assert grown > 150 and run.target > 10
    if method in RANKED or method == "gns":
        assert run.target == round(0.35 * grown) and run.model.count == run.target
    else:
        assert run.model.count <= run.target


# --- one map for all rows, and checkpoints


@pytest.mark.parametrize("iteration", [8, 33, 47, 62])
@pytest.mark.parametrize("method", FAMILIES)
def test_a_run_restored_from_a_checkpoint_goes_on_bit_for_bit(tmp_path, method, iteration):
    whole, first, second = grown_run(method), grown_run(method), grown_run(method)
    while first.iteration < iteration:
        first.advance()
    first.close()
    checkpoint.save(first, tmp_path, "same")
    assert checkpoint.restore(second, tmp_path, "same") and state(second) == state(first)
    assert state(to_the_end(second)) == state(to_the_end(whole))


@pytest.mark.parametrize("method", [name for name in LEARNED if METHODS[name].learns_masks])
def test_logits_follow_their_gaussians(method):
    """A logit that says which Gaussian it belongs to still does after clones, splits, a new order and an event."""
    run = grown_run(method)
    run.advance()
    rng = np.random.default_rng(0)
    run.model.values[MASK][:] = marks = rng.uniform(3, 4, run.model.count).astype(np.float32)
    run.model.sh[:, 0, 0] = marks  # a second copy, in an array that clones and splits leave alone
    run.model.moments[MASK][:] = 0
    before = run.model.count
    run.statistics.total[:], run.statistics.views[:] = 1.0, 1  # everything grows
    run._densify(run.settings.phases[0], 10, run.settings.phases[0].densify)
    run.model.reorder(rng.permutation(run.model.count))
    run.model.keep(rng.random(run.model.count) < 0.7)
    assert run.model.count != before and (run.model.origin == -1).any()
    np.testing.assert_array_equal(run.model.values[MASK], run.model.sh[:, 0, 0])
    run.close()


# --- engines


@pytest.mark.parametrize("method", FAMILIES[:4])
def test_every_learned_method_ends_alike_with_either_engine(method):
    """In float64, through growth, reset, pruning and recovery. Worst seen: 2.1e-14 of the largest value."""
    native, torch_ = (to_the_end(grown_run(method, engine("float64"), np.float64)) for engine in (NativeEngine, TorchEngine))
    np.testing.assert_array_equal(native.model.origin, torch_.model.origin)
    assert native.method.state() == pytest.approx(torch_.method.state(), rel=1e-12)
    for name, value in native.model.values.items():
        assert np.abs(value - torch_.model.values[name]).max() < 1e-11 * np.abs(value).max(), name


@pytest.mark.parametrize("penalty", [MeanExistence(0.3), OpacityPressure(2e-4, True), OpacityPressure(6e-4, False)])
def test_penalties_have_the_gradient_of_their_value(penalty):
    logits = np.random.default_rng(0).normal(0, 3, 50)
    leaf = torch.tensor(logits, requires_grad=True)
    penalty.value(leaf, torch).backward()
    assert float(penalty.value(logits, np)) == pytest.approx(penalty.value(leaf, torch).item(), rel=1e-13)
    np.testing.assert_allclose(penalty.grad(logits), leaf.grad.numpy(), rtol=1e-12)
    assert penalty.grad(logits.astype(np.float32)).dtype == np.float32


def test_the_gates_gradient_is_that_of_opacity_and_scale():
    """Against central differences of the image loss in g, g scaling the activated opacity and scales of one Gaussian at a time."""
    scene = scenes.random_scene(25, 3, 1, scale=0.3, opacity=-0.5)
    dataset = photographed(scene)
    model = Model.of(replace(scene, sh=scene.sh + np.float32(0.2)), np.float64)
    model.add_masks(1.0)
    phase = Phase("train", 10, Rates(), active=True)
    run = Run(model, dataset, plan_of("compact3dgs", (phase,), lambda_m=0.0, mask_init=1.0), NativeEngine("float64"))
    view, target = dataset.cameras[0], dataset.pictures[0] / 255
    step = run._step(phase, 1, view, target)
    r = run.engine.rasterizer

    def loss(gate: float, i: int) -> float:
        changed = Model({name: value.copy() for name, value in model.values.items()})
        o = gate / (1 + math.exp(-model.opacity_logits[i]))
        changed.opacity_logits[i] = math.log(o / (1 - o))
        changed.log_scales[i] += math.log(gate)
        l1, ssim, _ = r.loss(r.forward(changed, view, step.options)["rgb"], target, want_grad=False)
        return step.l1_weight * l1 + step.ssim_weight * (1 - ssim)

    numeric = np.array([(loss(1 + 1e-6, i) - loss(1 - 1e-6, i)) / 2e-6 for i in range(model.count)])
    image = r.forward(model, view, step.options, step.masks)["rgb"]
    grads = r.backward({"rgb": r.loss(image, target)[2]}, ("masks", "log_scales"))
    ids = r.visible()
    found = mask_logit_rows(step, grads, ids) / step.slope[ids]
    assert np.abs(found).max() > 1e-4
    np.testing.assert_allclose(found, numeric[ids], rtol=0, atol=2e-4 * np.abs(numeric).max())  # |a - b| has corners


def test_a_closed_gate_neither_shows_nor_learns_from_the_image():
    scene = scenes.random_scene(25, 3, 1, scale=0.3)
    run = Run(Model.of(scene), photographed(scene), replace(train_settings("compact3dgs", 10, 0), lambda_m=0.0), NativeEngine())
    run._prepare(run.settings.phases[0], 1)
    run.model.values[MASK][:5] = compact3dgs.THRESHOLD - 1e-3
    before = {name: run.model.values[name][run.model.origin < 25].copy() for name in (*PARAMETERS, MASK)}
    closed = run.model.values[MASK] < compact3dgs.THRESHOLD
    step = run._step(run.settings.phases[0], 1, run.dataset.cameras[0], np.ascontiguousarray(run.dataset.pictures[0] / 255, np.float32))
    run.engine.step(run.model, step)
    for name, old in before.items():
        np.testing.assert_array_equal(run.model.values[name][closed], old[closed])
    assert (run.model.values[MASK][~closed] != before[MASK][~closed]).any()


# --- gns


def test_gns_ends_at_its_budget_and_keeps_the_opaque():
    scene = scenes.random_scene(400, 1, 0, scale=0.1)
    settings = replace(prune_settings("gns", 320, 0, seed=1), target=100)
    run = to_the_end(Run(Model.of(scene), photographed(scene), settings, NativeEngine()))
    assert run.model.count == 100 and 0 < run.method.trimmed <= 320 and run.method.factor != 1.0
    kept = np.isin(np.arange(400), run.model.origin)
    assert scene.opacity_logits[kept].mean() > scene.opacity_logits[~kept].mean()


def test_gns_draws_in_proportion_to_opacity():
    model = Model.of(scenes.random_scene(30_000, sh_degree=0))
    model.opacity_logits[:] = np.where(np.arange(30_000) < 15_000, np.log(0.8 / 0.2), np.log(0.2 / 0.8))
    kept = opacity_pressure.drawn_by_opacity(model, 300, [0, 2, 5])
    assert kept.sum() == 300 and kept[:15_000].sum() == pytest.approx(240, abs=5 * math.sqrt(300 * 0.16))
    assert (opacity_pressure.drawn_by_opacity(model, 300, [0, 2, 6]) != kept).any()


def test_gns_finds_the_opacity_that_the_budget_reaches():
    logits = np.log(np.arange(1, 100) / np.arange(99, 0, -1)).astype(np.float32)  # opacities 0.01 ... 0.99
    assert opacity_pressure.opacity_at(np.random.default_rng(0).permutation(logits), 10) == pytest.approx(0.90, rel=1e-5)
    assert opacity_pressure.opacity_at(logits, 1_000) == pytest.approx(0.01, rel=1e-5)


# --- scores


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
    """Sum and maximum of alpha T, and LightGaussian's sum of opacity T. Worst seen: 1.7e-7 of the largest in float32, 3e-16 in float64."""
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
    arguments = scene, CAMERAS, r, RenderOptions()
    found = METHODS["contribution"].score(*arguments), METHODS["max-contribution"].score(*arguments), scores.significance(*arguments)
    bounds = (1e-13, 1e-7, 1e-13) if level == "float64" else (2e-6,) * 3  # the maximum is kept in float32
    for value, wanted, bound in zip(found, expected, bounds, strict=True):
        np.testing.assert_allclose(value, wanted, rtol=0, atol=bound * wanted.max())


def test_lightgaussians_volume_counts_for_little_and_is_clamped():
    log_scales = np.log(np.cbrt(np.arange(1, 101.0)))[:, None].repeat(3, axis=1)
    factor = lightgaussian.volume_factor(log_scales)  # volumes 1 ... 100; the 90th counts as 1
    np.testing.assert_allclose(factor, np.minimum(np.arange(1, 101) / 90, 1) ** 0.1, rtol=1e-12)
    assert len(lightgaussian.volume_factor(log_scales[:0])) == 0


def test_lightgaussian_keeps_34_percent_unless_told_otherwise():
    assert train_settings("lightgaussian", 10, 10).share == pytest.approx(0.34)
    assert train_settings("lightgaussian", 10, 10, target=7).share == 0
    assert train_settings("lightgaussian", 10, 10, share=0.5).share == 0.5


# --- pup


VIEWS = {"front": CAMERAS[0], "rolled": CAMERAS[1], "inside": scenes.camera(24, 40, eye=(0.3, 0.2, -0.9))}


def small_scene(dtype):
    """30 Gaussians of one colour each: what turns with the view is no part of the sensitivity."""
    scene = typed(scenes.random_scene(30, 3, 0, scale=0.3), dtype)
    scene.count = 30
    return scene


@functools.cache
def expected_sensitivities(view: str) -> np.ndarray:
    return sensitivities(small_scene(np.float64), VIEWS[view])


def sensitivities(scene, camera) -> np.ndarray:
    """H (N, 6, 6) by brute force: the reference's Jacobian of every colour in every mean and log-scale."""
    tensors = [torch.tensor(np.asarray(getattr(scene, name), np.float64)) for name in PARAMETERS]
    viewmat, K, background = (torch.tensor(np.asarray(a, np.float64)) for a in (camera.viewmat, camera.K, BACKGROUND))

    def colours(means, log_scales):
        ones = torch.ones(scene.count, dtype=torch.float64)
        return reference.rasterize(means, log_scales, *tensors[2:], ones, viewmat, K, camera.width, camera.height, background).rgb.reshape(-1)

    g = torch.cat(torch.autograd.functional.jacobian(colours, tuple(tensors[:2])), dim=2)  # (colours, N, 6)
    return torch.einsum("pni,pnj->nij", g, g).numpy()


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("view", VIEWS)
def test_sensitivities_are_those_of_the_reference(level, view):
    """Worst seen, of each matrix's largest value: 3.9e-14 in float64, 2.5e-5 in float32."""
    r, camera = rasterizer(level), VIEWS[view]
    scene, expected = small_scene(r.dtype), expected_sensitivities(view)
    r.forward(scene, camera, RenderOptions(background=BACKGROUND), outputs=())
    ids = r.visible()
    found = np.zeros((30, 6, 6))
    upper = sensitivity._view_part(r.moments(), sensitivity.jacobians(scene, camera, ids))
    found[ids[:, None], sensitivity._UPPER[0], sensitivity._UPPER[1]] = upper
    found[ids[:, None], sensitivity._UPPER[1], sensitivity._UPPER[0]] = upper
    scale = np.abs(expected).max(axis=(1, 2))
    assert (scale > 0).sum() > 10
    assert np.abs(found[scale == 0]).max(initial=0) == 0
    worst = (np.abs(found - expected).max(axis=(1, 2))[scale > 0] / scale[scale > 0]).max()
    assert worst < (1e-12 if level == "float64" else 2e-4)


def test_pup_ranks_by_the_determinant_over_all_views():
    scene = small_scene(np.float64)
    scene.means[7] = (0, 0, -50)  # behind every camera
    expected = sum(sensitivities(scene, camera) for camera in CAMERAS)
    found = sensitivity.log_determinants(scene, CAMERAS, rasterizer("float64"), RenderOptions(background=BACKGROUND))
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


@pytest.mark.parametrize("method", RANKED)
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
    score = METHODS[method].score(moved.model, dataset.cameras, moved.engine.rasterizer, RenderOptions())
    assert sorted(run.model.origin) == sorted(np.argsort(-score, kind="stable")[:25])


def test_scene_is_accepted_as_well_as_model():
    scene: Scene = scenes.random_scene(20, 4, 1)
    for method in RANKED:
        assert METHODS[method].score(scene, CAMERAS, rasterizer(LEVELS[0]), RenderOptions()).shape == (20,)
