"""The time that each kind of skipped work saves, and the change of the picture, which should be none."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np

from svrgs_addon.native.library import skips
from svrgs_addon.scene.gaussians import SH_COEFFICIENTS

from .cases import Case
from .measure import work_counts
from .timing import ratio, rounds, seconds
from .trial import WANTED, Trial


def measure_skips(case: Case, repeat: int, progress: Callable[[str], None]) -> list[dict]:
    """The entry `skips` of the result."""
    trial = Trial(case)
    entries = []
    for skip in skips():
        progress(f"skip {skip}")
        entries.append(_native(trial, skip, repeat))
    for measured in (_mask, _behind_the_stop, _kept_view, _unused_gradients, _sparse_adam, _sh_bands):
        progress(f"skip {measured.__name__.strip('_')}")
        entries.append(measured(trial, repeat))
    return entries


def _entry(
    skip: str, stage: str, once: Callable[[], dict[str, float]], repeat: int, image_max: float | None, **more
) -> dict:
    """One entry. once(): measures the seconds with the skip ('on') and without it ('off'); more: further keys
    of the entry."""
    readings = rounds(once, repeat)
    on, off = readings["on"], readings["off"]
    times = dict(on_ms=1e3 * float(np.median(on)), off_ms=1e3 * float(np.median(off)), gain=ratio(off, on))
    return {"skip": skip, "stage": stage, **times, "image_max": image_max, **more}


def _native(trial: Trial, skip: str, repeat: int) -> dict:
    """A skip of the rasteriser: the time of colours with and without it, the gain of a whole step, and the
    work counts."""
    disabled = (skip,)
    change = np.abs(trial.forward()["rgb"] - trial.forward(disabled_skips=disabled)["rgb"]).max()
    steps = rounds(lambda: {"on": seconds(trial.step), "off": seconds(trial.step, disabled)}, repeat)
    more = {
        "step_gain": ratio(steps["off"], steps["on"]),
        "work_on": work_counts(trial),
        "work_off": work_counts(trial, disabled),
    }

    def colours() -> dict[str, float]:
        on = seconds(trial.forward, "none")
        return {"on": on, "off": seconds(trial.forward, "none", disabled_skips=disabled)}

    return _entry(skip, "forward", colours, repeat, float(change), **more)


def _forward_backward(trial: Trial, mask_kind: str, full: bool) -> float:
    """Seconds of a forward pass and of the backward pass to all parameters."""
    image_grads = trial.image_grads if mask_kind != "none" else {"rgb": trial.image_grads["rgb"]}
    return seconds(trial.forward, mask_kind, full) + seconds(trial.rasterizer.backward, image_grads, WANTED)


def _mask(trial: Trial, repeat: int) -> dict:
    """Colours only, against colours and F with its gradient; both up to the stop."""
    once = {"on": ("none", False), "off": ("svr", False)}
    both = lambda: {name: _forward_backward(trial, *kind) for name, kind in once.items()}
    return _entry("mask", "forward and backward", both, repeat, None)


def _behind_the_stop(trial: Trial, repeat: int) -> dict:
    """F up to the stop of the colours, against F to the end of each ray. The two F differ by definition, so
    no pictures are compared."""
    once = {"on": ("svr", False), "off": ("svr", True)}
    both = lambda: {name: _forward_backward(trial, *kind) for name, kind in once.items()}
    return _entry("behind_the_stop", "forward and backward", both, repeat, None)


def _kept_view(trial: Trial, repeat: int) -> dict:
    """A picture, against one whose view is kept for gradients and statistics."""

    def draw(picture_only: bool):
        options = replace(trial.options("none", full=False), picture_only=picture_only)
        return trial.rasterizer.forward(trial.model, trial.case.camera, options, trial.masks)["rgb"]

    change = np.abs(draw(True) - draw(False)).max()
    both = lambda: {"on": seconds(draw, True), "off": seconds(draw, False)}
    return _entry("kept_view", "forward", both, repeat, float(change))


def _unused_gradients(trial: Trial, repeat: int) -> dict:
    """Gradients of the masks only, against gradients of all parameters."""
    trial.forward()
    both = lambda: {"on": seconds(trial.backward, ("masks",)), "off": seconds(trial.backward, WANTED)}
    return _entry("unused_gradients", "backward", both, repeat, None)


def _sparse_adam(trial: Trial, repeat: int) -> dict:
    """Adam on the visible Gaussians, against Adam on all. Moments of the others differ by definition, so no
    pictures are compared."""
    trial.forward()
    ids, grads = trial.rasterizer.visible(), trial.backward()
    dense = {name: np.zeros((trial.model.count, *grad.shape[1:]), grad.dtype) for name, grad in grads.items()}
    for name, grad in grads.items():
        dense[name][ids] = grad
    both = lambda: {"on": trial.adam(grads, ids), "off": trial.adam(dense, None)}
    return _entry("sparse_adam", "adam", both, repeat, None)


def _sh_bands(trial: Trial, repeat: int) -> dict:
    """A scene of SH degree 0 in arrays of degree 3: the higher bands, which are 0, are left out, against
    evaluated."""
    scene = trial.case.scene
    sh = np.zeros((scene.count, SH_COEFFICIENTS[3], 3), np.float32)
    sh[:, 0] = scene.sh[:, 0]
    flat = Trial(replace(trial.case, scene=replace(scene, sh=sh)))

    def project(sh_degree: int) -> float:
        flat.forward(sh_degree=sh_degree)
        return flat.rasterizer.stage_seconds()["project"]

    change = np.abs(flat.forward(sh_degree=0)["rgb"] - flat.forward()["rgb"]).max()
    return _entry("sh_bands", "project", lambda: {"on": project(0), "off": project(3)}, repeat, float(change))
