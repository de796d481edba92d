"""Methods that cut by a rule of their own, in several looks or events: each rule against the float64 reference."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch

import scenes
from native_helpers import rasterizer, typed
from reference import rasterize as reference
from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.finetune.methods.gaussianpop import LOOKS
from svrgs_addon.finetune.model import PARAMETERS
from svrgs_addon.native import RenderOptions

CAMERAS = [scenes.camera(29, 23), scenes.camera(31, 21, eye=(1.5, -1.0, -3.5), roll=20)]  # too small to be reduced
BACKGROUND = (0.2, 0.5, 0.9)
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
    double = typed(scene, r.dtype)
    double.count = 24
    kept = METHODS["gaussianpop"].cut(double, CAMERAS, r, OPTIONS, 6)
    assert kept.sum() == 6 and (kept == expected).all()
    assert not kept[once].all(), "one look would have kept the same: the test shows nothing"
    assert METHODS["gaussianpop"].cut(double, CAMERAS, r, OPTIONS, 100).all()
