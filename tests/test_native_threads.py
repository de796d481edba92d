"""Cancelling, renderers side by side, and fewer threads than asked for."""

import os
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

import scenes
from native_helpers import CAMERA, FLOAT_IMAGES, assert_same_bits, typed
from svrgs_addon.native import library
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.system.errors import Cancelled, NativeError

ROOT = Path(__file__).resolve().parents[1]


def test_cancel_stops_every_call_and_the_next_one_works():
    r, scene = Rasterizer(), scenes.random_scene(50, 1, 1)
    arrays, options = typed(scene, r.dtype), RenderOptions(mask_kind="svr")
    expected = r.forward(arrays, CAMERA, options, outputs=FLOAT_IMAGES)
    ones = np.ones((27, 40), r.dtype)
    scores = (np.zeros(50), np.zeros(50, np.float32), np.zeros(50, np.int64))
    gradient = r.backward({"alpha": ones}, ("masks",))["masks"].copy()
    r.cancel[0] = 1
    for call in (
        lambda: r.backward({"alpha": ones}, ("masks",)),
        lambda: r.add_scores(*scores),
        lambda: r.forward(arrays, CAMERA, options),
    ):
        with pytest.raises(Cancelled):
            call()
    assert not any(s.any() for s in scores)
    with pytest.raises(NativeError, match="forward"):  # the cancelled view is not there
        r.backward({"alpha": ones}, ("masks",))
    r.cancel[0] = 0
    assert_same_bits(r.forward(arrays, CAMERA, options, outputs=FLOAT_IMAGES), expected)
    assert r.backward({"alpha": ones}, ("masks",))["masks"].tobytes() == gradient.tobytes()


def test_cancel_from_another_thread():
    r, scene = Rasterizer(), scenes.random_scene(2000, 1, 1)
    arrays, camera = typed(scene, r.dtype), scenes.camera(300, 200)
    threading.Timer(0.05, r.cancel.fill, (1,)).start()
    deadline = time.monotonic() + 20
    with pytest.raises(Cancelled):
        while time.monotonic() < deadline:
            r.forward(arrays, camera)


def test_renderers_work_side_by_side():
    """One per Python thread; the pool is shared."""
    jobs = [(scenes.random_scene(500, seed, 1), Rasterizer()) for seed in range(4)]
    views = [(typed(scene, r.dtype), r) for scene, r in jobs]
    expected = [r.forward(arrays, CAMERA)["rgb"].tobytes() for arrays, r in views]
    got = [[] for _ in jobs]

    def work(k: int):
        arrays, r = views[k]
        got[k] = [r.forward(arrays, CAMERA)["rgb"].tobytes() for _ in range(20)]

    workers = [threading.Thread(target=work, args=(k,)) for k in range(4)]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    assert all(set(images) == {expected[k]} for k, images in enumerate(got))


@pytest.mark.skipif("LD_PRELOAD" in os.environ, reason="a sanitizer needs the address space for itself")
def test_fewer_threads_where_the_system_gives_no_more():
    """In a process of its own whose address space holds few stacks."""
    code = (
        "import resource\nfrom svrgs_addon.native import library\nfrom svrgs_addon.system.memory_limits"
        " import proc_bytes\nlibrary.threads()\nlimit = proc_bytes('self/status', 'VmSize') + (100 <<"
        " 20)\nresource.setrlimit(resource.RLIMIT_AS, (limit, limit))\nlibrary.set_threads(32)\nassert 1 <="
        " library.threads() < 32, library.threads()\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr


@pytest.mark.parametrize("asked", [1000, 10**26])
def test_threads_that_would_only_wait_are_not_started(asked, default_threads):
    library.set_threads(asked)
    assert library.threads() == max(32, 8 * len(os.sched_getaffinity(0)))


@pytest.mark.slow
def test_thousands_of_short_jobs_with_more_threads_than_cores():
    """In a process of its own: a thread that left a job too late would change a bit, and one that does not
    tell that it has left would let it wait for ever."""
    code = (
        "import time\nimport numpy as np\nfrom svrgs_addon.native import library\nfrom"
        " svrgs_addon.native.rasterizer import sample_masks\n"
        "logits = np.random.default_rng(5).normal(0, 1, 3 * 8192 + 5).astype(np.float32)\n"  # four tasks
        "draw = lambda: sample_masks(logits, 1, 2)[0].tobytes()\nlibrary.set_threads(1)\nexpected ="
        " draw()\nlibrary.set_threads(9)\n"
        # long enough for the threads to sleep
        "for k in range(3000):\n    assert draw() == expected, k\n    if k % 50 == 0:\n       "
        " time.sleep(0.001)\n"
    )
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stderr
