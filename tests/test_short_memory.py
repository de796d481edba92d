"""Work by blocks where memory is short for more than the whole scene: smaller blocks, and smaller parts of a
view."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files.registry import write_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.blocks import visible
from svrgs_addon.prune.blocks.divided import MAX_BLOCK_COUNT, divide
from svrgs_addon.prune.recipes.by_blocks import as_memory_allows
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.system import memory
from svrgs_addon.system.errors import SceneError
from svrgs_bench.scenes import orbit_camera, room

COUNT = 6_000
CAMERA = orbit_camera(160, 120, 0.0)


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("room") / "room.ply"
    write_scene(path, room(COUNT, 2))
    return path


def test_a_view_is_looked_at_in_smaller_parts_where_memory_is_short(source, tmp_path, monkeypatch):
    rasterizer = Rasterizer()
    view = visible.DividedView(divide(source, tmp_path), CAMERA, rasterizer)
    many = view.seen()[0]
    parts: list[int] = []
    blended = visible.DividedView._blended
    counted = lambda *words: parts.append(sum(map(len, words[2]))) or blended(*words)
    monkeypatch.setattr(visible.DividedView, "_blended", counted)
    monkeypatch.setattr(visible, "FEWEST", COUNT // 100), monkeypatch.setattr(visible, "REACH", np.inf)
    monkeypatch.setattr(memory, "available", lambda: visible._needed(many.count + COUNT // 10, CAMERA))
    few = view.seen()[0]
    assert len(parts) == 2, "and no more, because its longer side would have less than MIN_SIDE_PIXELS pixels"
    images = [rasterizer.forward(scene, CAMERA, render_options(scene))["rgb"].copy() for scene in (many, few)]
    assert np.abs(images[0] - images[1]).max() < 2e-3
    monkeypatch.setattr(memory, "available", lambda: 100_000)
    with pytest.raises(SceneError, match="of the view .* needs about"):
        view.seen()


@pytest.mark.parametrize(
    "count, free, most",
    [
        (50_000_000, 10**12, MAX_BLOCK_COUNT),
        (1_000_000, 10**12, 1_000_000),
        (1_000_000, 10**9, 500_000),
        (1_000_000, 10**7, 125_000),
    ],
)
def test_blocks_are_as_large_as_memory_allows(count, free, most, monkeypatch):
    """A Gaussian of degree 3 takes about 0.6 kB while it is tuned; half of the memory may be used."""
    monkeypatch.setattr(memory, "available", lambda: free)
    assert as_memory_allows([CAMERA], 0)(count, 16) == most
