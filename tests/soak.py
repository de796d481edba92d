"""python -m tests.soak [--renders 10000]: pictures of changing scenes, views, sizes and kinds, one after the
other; memory must stay.

Scenes, renderers and the number of threads come and go; every third picture has a backward pass.
"""

from __future__ import annotations

import argparse
import ctypes
import random
import resource
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

from svrgs_addon.native import library
from svrgs_addon.native.library import mask_kinds
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_bench.scenes import orbit_camera, room

WARM_UP = 500  # renders in which buffers may grow to the largest scene and picture
LIMIT = 2e6  # bytes of growth after that; seen 0.1e6
COUNTS = (1, 40, 900, 4_000, 9_000)
SIZES = ((1, 1), (257, 16), (17, 130), (160, 120), (240, 160))
SCENE_EVERY, RENDERER_EVERY, THREADS_EVERY = 20, 5, 50  # renders


def resident() -> int:
    """Bytes that this process holds, without those freed that its allocator keeps for later."""
    getattr(ctypes.CDLL(None), "malloc_trim", lambda _: None)(0)
    return int(Path("/proc/self/statm").read_text().split()[1]) * resource.getpagesize()


def soak(renders: int, seen: Callable[[np.ndarray], object] = lambda image: None) -> np.ndarray:
    """Resident bytes after each render; seen: given each picture."""
    chance, sizes = random.Random(0), np.zeros(renders, np.int64)
    for number in range(renders):
        if number % THREADS_EVERY == 0:
            library.set_threads(chance.randint(1, 4))
        if number % SCENE_EVERY == 0:
            scene = room(chance.choice(COUNTS), chance.randrange(4), seed=number)
        if number % RENDERER_EVERY == 0:
            rasterizer = Rasterizer()
        kind = chance.choice(list(mask_kinds()))
        options = RenderOptions(
            chance.randrange(4), bool(chance.randrange(2)), bool(chance.randrange(2)), kind
        )
        outputs = ("rgb", "depth", "alpha", *(("mask",) if kind != "none" else ()))
        images = rasterizer.forward(
            scene, orbit_camera(*chance.choice(SIZES), turn=chance.uniform(0, 360)), options, outputs=outputs
        )
        if number % 3 == 0:
            rasterizer.backward({name: np.ones_like(images[name]) for name in outputs})
        seen(images["rgb"])
        sizes[number] = resident()
    return sizes


def growth(sizes: np.ndarray) -> int:
    """From the smallest size in the first half after the warm-up to that in the second: the least held
    between two scenes."""
    first, second = np.array_split(sizes[WARM_UP:], 2)
    return int(second.min() - first.min())


def main() -> int:
    parser = argparse.ArgumentParser(prog="python -m tests.soak")
    parser.add_argument("--renders", type=int, default=10_000)
    options = parser.parse_args()
    if options.renders <= WARM_UP:
        parser.error(f"the first {WARM_UP} renders are not judged: ask for more")
    started = time.perf_counter()
    sizes = soak(options.renders)
    grown = growth(sizes)
    shown = ", ".join(
        f"{part.min() / 1e6:.1f}-{part.max() / 1e6:.1f}" for part in np.array_split(sizes[WARM_UP:], 5)
    )
    print(
        f"{options.renders} renders, {time.perf_counter() - started:.0f} s; resident MB: {shown}; grown by"
        f" {grown / 1e6:.2f} MB after the first {WARM_UP}"
    )
    return int(grown > LIMIT)


if __name__ == "__main__":
    sys.exit(main())
