"""Renderers, the library and the arrays of a view: they come and go without a trace."""

import os
import subprocess
import sys
import weakref

import numpy as np
import pytest

import scenes
from native_helpers import frontal, typed
from svrgs_addon.native.rasterizer import Rasterizer


def test_a_thousand_renderers_come_and_go():
    scene = scenes.random_scene(20, 1, 0)
    for _ in range(1000):
        r = Rasterizer()
        r.forward(typed(scene, r.dtype), frontal(20, 20), outputs=())
    assert r.visible().size


COMING_AND_GOING = """
import _ctypes, gc, hashlib, os, sys
from svrgs_bench.scenes import orbit_camera, room
scene, camera, found = room(500, 1), orbit_camera(64, 48), set()
before = len(os.listdir("/proc/self/task")) if os.path.exists("/proc/self/task") else 0
for _ in range(20):
    from svrgs_addon.native import library, rasterizer
    library.set_threads(3)
    found.add(hashlib.sha256(rasterizer.Rasterizer().forward(scene, camera)["rgb"]).hexdigest())
    library.set_threads(1)
    gc.collect()
    handle = library.library()._handle
    del library, rasterizer
    for name in ("library", "rasterizer"):
        del sys.modules["svrgs_addon.native"].__dict__[name], sys.modules[f"svrgs_addon.native.{name}"]
    _ctypes.dlclose(handle)
assert not before or len(os.listdir("/proc/self/task")) == before, "threads are left"
print(len(found))
"""


@pytest.mark.skipif(os.name == "nt", reason="its libraries are let go of by another call")
def test_the_library_comes_and_goes_and_comes():
    done = subprocess.run([sys.executable, "-c", COMING_AND_GOING], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, "1\n"), done.stderr


def test_arrays_of_a_view_stay_alive_until_the_next():
    """The library still reads them in the backward pass, whatever becomes of the scene."""
    r, scene = Rasterizer("scalar"), typed(scenes.random_scene(7, 1, 1), np.float32)
    masks = np.ones(7, np.uint8)
    arrays = [weakref.ref(a) for a in (*vars(scene).values(), masks)]
    r.forward(scene, frontal(6, 5), masks=masks)
    vars(scene).clear()
    del scene, masks
    assert all(array() is not None for array in arrays)
    r.forward(typed(scenes.random_scene(3), np.float32), frontal(6, 5))
    assert all(array() is None for array in arrays)
