"""Saliency of a Gaussian, and the method that prunes by it in events."""

from dataclasses import replace

import numpy as np
import pytest

import scenes
from pictures import photographed
from plans import prune_settings, train_settings
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.saliency import SHARE, saliency
from svrgs_addon.finetune.settings import Densify
from svrgs_addon.native import Rasterizer, RenderOptions

COUNT = 60


def scene_and_data(count: int = COUNT):
    scene = scenes.random_scene(count, 2, 1, scale=0.25)
    return scene, photographed(scene)


def run_of(settings, count: int = COUNT) -> Run:
    scene, data = scene_and_data(count)
    return Run(Model.of(scene), data, settings, NativeEngine())


def counts_of(run: Run) -> list[int]:
    """Gaussians after each step."""
    counts = []
    while not run.finished:
        run.advance()
        counts.append(run.model.count)
    run.close()
    return counts


def test_saliency_is_the_removal_error_over_the_mask_penalty():
    """One view, not made smaller, and renders that really leave each Gaussian out."""
    scene = scenes.random_scene(30, 5, 1, scale=0.3)
    scene.opacity_logits[:] = np.minimum(scene.opacity_logits, -1.0)  # no ray stops
    camera = scenes.camera(41, 31)
    r, options = Rasterizer("float64"), RenderOptions(mask_kind="svr")
    double = Model.of(scene, np.float64)
    found = saliency(double, [camera], r, options)
    whole = {name: image.copy() for name, image in r.forward(double, camera, options, outputs=("rgb", "mask", "hits")).items()}
    for i in range(scene.count):
        masks = np.ones(scene.count, np.uint8)
        masks[i] = 0
        without = r.forward(double, camera, options, masks, ("rgb", "mask"))
        change = whole["mask"] - without["mask"]  # F is linear: dF/dM times 1
        pixels = change > 0
        if not pixels.any():
            assert found[i] == 0
            continue
        removal_error = ((whole["rgb"] - without["rgb"]) ** 2).mean()
        mask_penalty = SHARE * (2 * whole["mask"] * change).sum() / pixels.sum()
        assert found[i] == pytest.approx(removal_error / mask_penalty, rel=1e-9)


def test_a_larger_lambda_leaves_fewer():
    left = [counts_of(run_of(prune_settings("saliency", 8, 0, lambda_f=weight)))[-1] for weight in (1e-7, 3e-1, 10)]
    assert COUNT >= left[0] > left[1] > left[2] >= 1


def test_the_target_is_approached_in_equal_ratios_and_met():
    counts = counts_of(run_of(replace(prune_settings("saliency", 16, 4), target=15)))
    assert counts[-1] == 15
    events = counts[1:16:2]
    np.testing.assert_allclose(events, [COUNT * (15 / COUNT) ** (k / 8) for k in range(1, 9)], atol=1)


def test_a_target_above_the_count_prunes_nothing():
    assert counts_of(run_of(replace(prune_settings("saliency", 8, 0), target=1_000)))[-1] == COUNT


def test_no_more_is_lost_than_allowed():
    scene, data = scene_and_data()
    scene.sh[:] += np.random.default_rng(1).normal(0, 0.1, scene.sh.shape)  # something to lose against
    run = Run(Model.of(scene), data, replace(prune_settings("saliency", 16, 0), max_drop=1.0), NativeEngine())
    before = run.psnr(None)
    assert counts_of(run)[-1] < COUNT
    assert 10 < before - 1.0 <= run.psnr(None)


def test_in_training_events_come_after_densification():
    rule = Densify(start=100, until=10, every=5, reset_every=1_000)
    phases = train_settings("saliency", 20, 0, densify=rule, target=30).phases
    run = run_of(replace(train_settings("saliency", 20, 0, densify=rule, target=30), phases=(replace(phases[0], prune_every=5),)))
    counts = counts_of(run)
    assert counts[:14] == [COUNT] * 14 and COUNT > counts[14] > counts[19] == 30
