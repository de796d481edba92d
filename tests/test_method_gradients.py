"""What a method adds to the loss: penalties and gates have the gradient of their value."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

import scenes
from pictures import photographed
from plans import plan_of, train_settings
from svrgs_addon.finetune.engine import NativeEngine, mask_logit_rows
from svrgs_addon.finetune.methods import compact3dgs
from svrgs_addon.finetune.model import MASK, Model
from svrgs_addon.finetune.penalties import (
    EffectiveRank,
    MeanExistence,
    MeanOpacity,
    MeanScale,
    OpacityGoal,
    OpacityPressure,
)
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Phase, Rates
from svrgs_addon.scene.gaussians import PARAMETERS


@pytest.mark.parametrize(
    "penalty",
    [
        MeanExistence(0.3),
        MeanOpacity(0.3),
        MeanScale(0.2),
        EffectiveRank(),
        EffectiveRank(0.1, 0.5),
        OpacityGoal(0.3, np.linspace(-1, 1, 50)),
        OpacityPressure(2e-4, True),
        OpacityPressure(6e-4, False),
    ],
)
def test_penalties_have_the_gradient_of_their_value(penalty):
    logits = np.random.default_rng(0).normal(0, 3, (50, 3) if penalty.parameter == "log_scales" else 50)
    leaf = torch.tensor(logits, requires_grad=True)
    penalty.value(leaf, torch).backward()
    assert float(penalty.value(logits, np)) == pytest.approx(penalty.value(leaf, torch).item(), rel=1e-13)
    np.testing.assert_allclose(penalty.grad(logits), leaf.grad.numpy(), rtol=1e-12)
    assert penalty.grad(logits.astype(np.float32)).dtype == np.float32


def test_the_gates_gradient_is_that_of_opacity_and_scale():
    """Against central differences of the image loss in g, g scaling the activated opacity and scales of one
    Gaussian at a time."""
    scene = scenes.random_scene(25, 3, 1, scale=0.3, opacity=-0.5)
    dataset = photographed(scene)
    model = Model.of(replace(scene, sh=scene.sh + np.float32(0.2)), np.float64)
    model.add_masks(1.0)
    phase = Phase("train", 10, Rates(), active=True)
    run = Run(
        model, dataset, plan_of("compact3dgs", (phase,), lambda_m=0.0, mask_init=1.0), NativeEngine("float64")
    )
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
    # |a - b| has corners
    np.testing.assert_allclose(found, numeric[ids], rtol=0, atol=2e-4 * np.abs(numeric).max())


def test_a_closed_gate_neither_shows_nor_learns_from_the_image():
    scene = scenes.random_scene(25, 3, 1, scale=0.3)
    plan = replace(train_settings("compact3dgs", 10, 0), lambda_m=0.0)
    run = Run(Model.of(scene), photographed(scene), plan, NativeEngine())
    run._prepare(run.plan.phases[0], 1)
    run.model.values[MASK][:5] = compact3dgs.THRESHOLD - 1e-3
    before = {name: run.model.values[name][run.model.origin < 25].copy() for name in (*PARAMETERS, MASK)}
    closed = run.model.values[MASK] < compact3dgs.THRESHOLD
    step = run._step(
        run.plan.phases[0],
        1,
        run.dataset.cameras[0],
        np.ascontiguousarray(run.dataset.pictures[0] / 255, np.float32),
    )
    run.engine.step(run.model, step)
    for name, old in before.items():
        np.testing.assert_array_equal(run.model.values[name][closed], old[closed])
    assert (run.model.values[MASK][~closed] != before[MASK][~closed]).any()
