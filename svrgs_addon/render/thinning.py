"""Fewer Gaussians for coarse pictures, where a pixel shows dozens of them."""

from __future__ import annotations

import threading
from dataclasses import replace

import numpy as np

from ..native.rasterizer import Rasterizer
from ..scene.concatenate import concatenated
from ..scene.gaussians import Scene

GROUP = 4  # Gaussians that one stands for
MAX_SEEN = 500_000  # Gaussians that are all drawn
PART = 1 << 16  # groups that are made together


def thinned(scene: Scene) -> Scene:
    """One Gaussian for each GROUP that follow each other, which are neighbours in Morton order: the one that
    covers most, as large as all of them together, in their mean colour. Further columns are left out."""
    starts = range(0, scene.count, GROUP * PART)
    return concatenated([_thinned(scene.select(slice(start, start + GROUP * PART))) for start in starts])


def _thinned(scene: Scene) -> Scene:
    count = -(-scene.count // GROUP)
    weights = np.zeros(count * GROUP, np.float32)
    logs = np.sort(np.clip(scene.log_scales, -40, 40), axis=1)
    inverse_opacities = 1 + np.exp(-np.clip(scene.opacity_logits, -40, 40))
    weights[: scene.count] = np.exp(logs[:, 1] + logs[:, 2]) / inverse_opacities + np.float32(1e-30)
    groups = weights.reshape(count, GROUP)
    largest = groups.argmax(axis=1) + GROUP * np.arange(count)
    growth = np.minimum(groups.sum(axis=1) / weights[largest], GROUP)
    chosen = scene.select(largest)
    values = np.zeros((count * GROUP, chosen.sh[0].size), np.float32)
    values[: scene.count] = scene.sh.reshape(scene.count, -1)
    shares = groups / groups.sum(axis=1, keepdims=True)
    sh = np.einsum("ng,ngk->nk", shares, values.reshape(count, GROUP, -1)).reshape(chosen.sh.shape)
    return replace(chosen, log_scales=chosen.log_scales + np.log(growth)[:, None] / 2, sh=sh)


class Thinning:
    """Which Gaussians the coarse pictures of a scene draw: all, or the thinned ones while many are seen. A
    thread makes these; until then all are drawn."""

    def __init__(self, scene: Scene):
        self._scene = scene
        self._thin: Scene | None = None
        self._maker: threading.Thread | None = None
        self._seen = 0  # Gaussians of the whole scene that the last picture has shown, about

    def draws(self) -> Scene:
        """The Gaussians of the next coarse picture."""
        return self._thin if self._thin is not None and self._seen > MAX_SEEN else self._scene

    def drew(self, scene: Scene, rasterizer: Rasterizer):
        """Takes note of what the last picture has shown. scene: that of draws(), or the whole one."""
        self._seen = rasterizer.work()["visible"] * (1 if scene is self._scene else GROUP)
        if self._seen > MAX_SEEN and self._maker is None:
            self._maker = threading.Thread(target=self._make, name="svrgs-thinning", daemon=True)
            self._maker.start()

    def wait(self):
        """Until the thinned Gaussians are there, if they are being made."""
        if self._maker is not None:
            self._maker.join()

    def _make(self):
        self._thin = thinned(self._scene)
