"""Where a result differs most from the original."""

from __future__ import annotations

import numpy as np
import pytest

from svrgs_addon.render.metrics import flip
from svrgs_addon.render.metrics.worst import SIDE, worst_of, worst_square


@pytest.mark.parametrize("shape", [(40, 60), (200, 170), (96, 500)])
def test_the_square_is_that_of_the_highest_mean(shape):
    values = np.random.default_rng(0).random(shape) ** 8
    (x, y, width, height), mean = worst_square(values)
    assert (width, height) == (min(SIDE, shape[1]), min(SIDE, shape[0]))
    windows = np.lib.stride_tricks.sliding_window_view(values, (height, width)).mean(axis=(2, 3))
    assert windows[y, x] == windows.max() == pytest.approx(mean, abs=1e-12)


def test_the_worst_of_some_views():
    rng = np.random.default_rng(1)
    original = rng.random((150, 160, 3)).astype(np.float32)
    slight, strong = np.clip(original + 0.001, 0, 1), original.copy()
    strong[20:60, 100:140] = 1 - strong[20:60, 100:140]
    found = worst_of([("a", original, slight), ("b", original, strong), ("c", original, original)])
    assert found.view == "b" and found.flip == pytest.approx(flip(original, strong), abs=1e-6)
    x, y, width, height = found.square
    assert x <= 100 and x + width >= 140 and y <= 20 and y + height >= 60
    assert (found.picture == strong[y : y + height, x : x + width]).all() and found.square_flip > found.flip
    assert worst_of([]) is None


@pytest.mark.parametrize(
    "way", [("--target", 0.3, "--iterations", 20, "--recovery", 10), ("--quick", "--target", 0.3)]
)
def test_it_stands_in_the_result_and_in_the_report(tiny, svrgs, small_rig, tmp_path, way):
    words = ("--data", tiny.folder, "--out", tmp_path / "o.ply", "--json")
    words += () if "--quick" in way else ("--report", tmp_path / "report")
    found = svrgs("prune", tiny.splat, *way, *words).json["worst"]
    assert found["view"] and 0 < found["flip"] <= found["square_flip"] <= 1 and len(found["square"]) == 4
    if "--report" in words:
        page = (tmp_path / "report/index.html").read_text("utf-8")
        assert f"{found['view']}, " in page and f"differs most, FLIP {found['square_flip']:.3f}" in page
