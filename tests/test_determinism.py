"""One hash for any number of threads: a view forward and backward, 100 fine-tuning steps, and which Gaussians
are pruned."""

from __future__ import annotations

import hashlib
import os
from dataclasses import replace

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from plans import prune_settings
from svrgs_addon.files.registry import load_scene
from svrgs_addon.finetune import loop
from svrgs_addon.finetune.engine import NativeEngine
from svrgs_addon.finetune.model import Model
from svrgs_addon.native import library
from svrgs_addon.native.library import GRADS
from svrgs_addon.native.rasterizer import IMAGES, Rasterizer, RenderOptions
from svrgs_addon.views.dataset import load_dataset
from svrgs_bench.scenes import orbit_camera, room

THREADS = (1, 2, 3, 7, 16)
pytestmark = pytest.mark.usefixtures("default_threads")


def hashed(arrays: dict[str, np.ndarray]) -> str:
    digest = hashlib.sha256()
    for name in sorted(arrays):
        digest.update(name.encode() + np.ascontiguousarray(arrays[name]).tobytes())
    return digest.hexdigest()


def one_view() -> tuple[str, str]:
    """Hashes of every image, and of every gradient of them, of a view with several chunks in every stage."""
    scene, camera, r = room(20_000, 1), orbit_camera(200, 150), Rasterizer()
    masks = (np.arange(scene.count) % 5 > 0).astype(np.uint8)
    images = r.forward(scene, camera, RenderOptions(mask_kind="svr"), masks, (*IMAGES, "hits", "kept"))
    weights = {
        name: np.cos(np.arange(images[name].size, dtype=np.float32)).reshape(images[name].shape)
        for name in ("rgb", "depth", "alpha", "mask")
    }
    return hashed(images), hashed(r.backward(weights, GRADS))


def hundred_steps(tiny, data) -> tuple[str, str]:
    """Hashes of all values and moments after 100 steps, and of the rows that every pruning event kept."""
    settings = replace(prune_settings("svr", 80, 20, prune_every=20, lambda_f=1e-3), mask_init=0.5, seed=5)
    run = loop.Run(Model.of(load_scene(tiny.splat)), data, settings, NativeEngine())
    kept = {}
    while not run.finished:
        run.advance()
        kept[str(run.iteration)] = run.model.origin.copy()
    run.close()
    assert 5 < len(kept["100"]) < len(kept["1"]), "pruning events should have bitten"
    state = {
        f"{part}.{name}": array
        for part in ("values", "moments")
        for name, array in getattr(run.model, part).items()
    }
    return hashed(state), hashed(kept)


def test_one_hash_for_any_number_of_threads(tiny):
    data, found = load_dataset(tiny.folder), {}
    for threads in THREADS:
        library.set_threads(threads)
        found[threads] = (*one_view(), *hundred_steps(tiny, data))
    assert len(set(found.values())) == 1, found


@pytest.mark.skipif(
    not hasattr(os, "sched_setaffinity"), reason="this system does not bind processes to cores"
)
def test_as_many_threads_as_the_process_may_use():
    allowed = os.sched_getaffinity(0)
    try:
        os.sched_setaffinity(0, {min(allowed)})
        library.set_threads(0)
        assert library.threads() == 1
    finally:
        os.sched_setaffinity(0, allowed)
    library.set_threads(0)
    assert library.threads() == len(allowed)
