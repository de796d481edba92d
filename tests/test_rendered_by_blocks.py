"""`svrgs render`, `eval` and `compare` of scenes that are too large for memory: they go over to blocks, say
so, and give the same pictures and figures."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import tiny_dataset
from svrgs_addon.files.registry import write_scene
from svrgs_addon.native.outputs import PICTURES
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.blocks import divided, folder
from svrgs_addon.prune.recipes import by_blocks
from svrgs_addon.system import memory
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_bench.scenes import orbit_camera, room

COUNT = 5_000
SAID = "it is done by blocks in "
mapped_files_are_listed = pytest.mark.skipif(
    not os.path.exists("/proc/self/maps"), reason="the system does not list what is mapped"
)


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    path = tmp_path_factory.mktemp("room") / "room.ply"
    write_scene(path, room(COUNT, 2))
    return path


@pytest.fixture(scope="module")
def cameras(source):
    path = source.with_name("cameras.json")
    write_cameras_json(
        path, [replace(orbit_camera(160, 120, turn), name=f"{turn}.png") for turn in (0.0, 0.3, 0.7)]
    )
    return path


@pytest.fixture
def short(monkeypatch, tmp_path):
    """As if memory sufficed for no scene as a whole. Returns the folder for temporary files."""
    place = tmp_path / "temporary"
    place.mkdir()
    monkeypatch.setattr(memory, "reading", lambda _: 10**15)
    monkeypatch.setattr(tempfile, "tempdir", str(place))
    monkeypatch.setattr(divided.divide, "__defaults__", (COUNT // 6, *divided.divide.__defaults__[1:]))
    return place


def rendered(svrgs, source, cameras, out, outputs=",".join(PICTURES)):
    done = svrgs(
        f"render {source} --cameras {cameras} --outputs {outputs} --format npy",
        f"--background 0.2,0.5,0.1 --out {out}",
    )
    assert done.status == 0, done.err
    return {path.name: np.load(path) for path in sorted(out.iterdir())}


def test_pictures_are_those_of_the_scene_in_memory(
    svrgs, monkeypatch, source, cameras, tmp_path, request, caplog
):
    in_memory = rendered(svrgs, source, cameras, tmp_path / "whole")
    assert SAID not in caplog.text
    place = request.getfixturevalue("short")
    in_blocks = rendered(svrgs, source, cameras, tmp_path / "blocks")
    assert f"{SAID}{place} (TMPDIR), which takes longer" in caplog.text and "svrgs convert" not in caplog.text
    assert not any(place.iterdir())
    assert in_memory.keys() == in_blocks.keys() and len(in_memory) == 3 * len(PICTURES)
    for name, picture in in_memory.items():
        bound = 0 if name.endswith(("depth.npy", "alpha.npy")) else 1e-6 * np.abs(picture).max()
        assert np.ptp(picture) > 0.1 and np.abs(in_blocks[name] - picture).max() <= bound, name


def test_memory_holds_one_block_of_those_that_the_spatial_mask_counts(
    svrgs, short, source, cameras, tmp_path, monkeypatch
):
    counts, forward = [], Rasterizer.forward

    def note(self, scene, *more, outputs=("rgb",), **named):
        if "hits" in outputs:
            counts.append(scene.count)
        return forward(self, scene, *more, outputs=outputs, **named)

    monkeypatch.setattr(Rasterizer, "forward", note)
    rendered(svrgs, source, cameras, tmp_path / "blocks", "mask")
    assert 0 < max(counts) <= COUNT // 6 and sum(counts) > 3 * COUNT // 2


def test_figures_are_those_of_the_scene_in_memory(svrgs, tiny, tmp_path, request, caplog):
    in_memory = svrgs("eval", tiny.splat, "--data", tiny.folder, "--json").json
    place = request.getfixturevalue("short")
    in_blocks = svrgs("eval", tiny.splat, "--data", tiny.folder, "--json").json
    assert SAID in caplog.text and not any(place.iterdir())
    assert in_memory.pop("ms_per_frame") > 0 and in_blocks.pop("ms_per_frame") is None
    assert in_blocks == pytest.approx(in_memory, abs=1e-4) and in_blocks["count"] == tiny_dataset.COUNT


def test_scenes_are_compared_by_blocks(svrgs, tiny, tmp_path, request, caplog):
    words = ["compare", tiny.splat, tiny.splat, "--data", tiny.folder, "--json"]
    in_memory = svrgs(*words, "--out", tmp_path / "whole").json
    request.getfixturevalue("short")
    found = svrgs(*words, "--out", tmp_path / "blocks").json
    assert caplog.text.count(SAID) == 2
    assert found["a"]["psnr"] == pytest.approx(in_memory["a"]["psnr"], abs=1e-4)
    assert sorted(path.name for path in (tmp_path / "blocks").iterdir()) == sorted(
        path.name for path in (tmp_path / "whole").iterdir()
    )
    assert (
        'Time per frame</th><td class="soft" colspan="3">not measured'
        in (tmp_path / "blocks/index.html").read_text()
    )


def test_pictures_of_a_divided_scene_take_the_place_of_photographs(
    svrgs, source, cameras, tmp_path, request, caplog
):
    words = ["compare", source, source, "--cameras", cameras, "--json"]
    assert svrgs(*words, "--out", tmp_path / "whole").json["b"]["psnr"] is None
    request.getfixturevalue("short")
    found = svrgs(*words, "--out", tmp_path / "blocks").json
    assert caplog.text.count(SAID) == 2 and found["a"].keys() == {"count", "bytes"}
    assert found["b"]["psnr"] is None and len(found["pictures"]) == 3


def test_other_cameras_are_refused(svrgs, short, tiny, tmp_path):
    far = tmp_path / "far.ply"
    scene = room(300, 0)
    scene.means[:] += 1e6
    write_scene(far, scene)
    said = svrgs("eval", far, "--data", tiny.folder)
    assert said.status == 2 and "none of its Gaussians is near a camera" in said.err
    assert not any(short.iterdir())


def test_pictures_that_are_too_large_are_refused_at_once(
    svrgs, short, monkeypatch, source, cameras, tmp_path
):
    monkeypatch.setattr(
        "svrgs_addon.prune.blocks.block_rasterizer.divide", lambda *_: pytest.fail("the scene was divided")
    )
    monkeypatch.setattr(memory, "available", lambda: 100_000)
    said = svrgs("render", source, "--cameras", cameras, "--out", tmp_path / "out")
    assert said.status == 2 and "of memory" in said.err and not (tmp_path / "out").exists()


@mapped_files_are_listed
def test_no_block_is_mapped_where_it_is_removed(svrgs, short, monkeypatch, source, cameras, tmp_path):
    """Windows removes no file that is."""
    mapped, cleanup = [], tempfile.TemporaryDirectory.cleanup
    monkeypatch.setattr(
        tempfile.TemporaryDirectory, "cleanup", lambda self: (mapped.append(all_mapped()), cleanup(self))
    )
    rendered(svrgs, source, cameras, tmp_path / "out")
    assert len(mapped) == 1 and "svrgs-blocks-" not in mapped[0]
    monkeypatch.setattr(by_blocks, "remove", lambda work: (mapped.append(all_mapped()), folder.remove(work)))
    words = f"--target 0.5 --out {tmp_path}/pruned.ply --block {COUNT // 3} --force"
    done = svrgs(f"large prune {source} --cameras {cameras}", words)
    assert done.status == 0 and len(mapped) == 2 and "pruned.ply.blocks" not in mapped[1]


def all_mapped() -> str:
    return Path("/proc/self/maps").read_text()


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no SIGTERM for other processes")
def test_a_stop_leaves_no_blocks_behind(source, cameras, tmp_path):
    (tmp_path / "temporary").mkdir()
    code = (
        "from svrgs_addon.system import memory; from svrgs_addon.cli.main import main;"
        " memory.reading = lambda _: 10**15; "
    )
    code += (
        "import svrgs_addon.prune.blocks.block_rasterizer as o, time, sys; o.seen = lambda *a, **k:"
        " time.sleep(60); sys.exit(main(sys.argv[1:]))"
    )
    words = [sys.executable, "-c", code, *f"render {source} --cameras {cameras} --out {tmp_path}/out".split()]
    process = subprocess.Popen(
        words, env={**os.environ, "TMPDIR": str(tmp_path / "temporary")}, stderr=subprocess.PIPE, text=True
    )
    end = time.monotonic() + 50
    while (
        not list((tmp_path / "temporary").glob("*/blocks.json"))
        and process.poll() is None
        and time.monotonic() < end
    ):
        time.sleep(0.02)
    process.send_signal(signal.SIGTERM)
    assert "interrupted" in process.communicate(timeout=30)[1] and process.returncode == 130
    assert not any((tmp_path / "temporary").iterdir())
