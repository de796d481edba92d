"""Jobs read and write compressed formats; their figures are those of the file that was written."""

from __future__ import annotations

import io
import zipfile

import numpy as np
import pytest

from svrgs_addon.cli.main import main
from svrgs_addon.files.registry import load_scene, read_scene, write_scene
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.pipeline import prune_scene
from svrgs_addon.render.metrics.measures import psnr
from svrgs_addon.system.errors import SceneError
from svrgs_addon.views.rig.around import cameras_around
from test_formats import by_gaussforge
from test_rendered_views import ball

pytestmark = pytest.mark.usefixtures("small_rig")


def prune(path, out, **more) -> dict:
    options = {"scene": path, "out": path.with_name(out), "target": 0.5, "quiet": True} | more
    return prune_scene(PruneOptions(**options))


@pytest.mark.parametrize("out", ["small.spz", "small.compressed.ply", "small.splat"])
def test_a_quick_job_goes_from_one_format_to_another(tmp_path, out):
    path = tmp_path / "ball.spz"
    write_scene(path, ball(1_000))
    result = prune(path, out, quick=True)
    small = tmp_path / out
    assert read_scene(small).count == result["count"] == 500
    assert result["after"]["bytes"] == small.stat().st_size
    assert result["before"]["bytes"] == path.stat().st_size


def test_what_the_format_costs_is_measured_and_said(tiny, tmp_path):
    options = {"data": tiny.folder, "iterations": 20, "recovery": 20}
    exact, stored = (
        prune(tmp_path / "x", name, scene=tiny.splat, **options) for name in ("small.ply", "small.spz")
    )
    said = [note for note in stored["notes"] if note.startswith("SPZ stores values in few bits")]
    assert said == [
        f"SPZ stores values in few bits: {stored['psnr'] - exact['psnr']:+.2f} dB; a .ply keeps every value"
    ]
    assert stored["psnr"] < exact["psnr"] - 0.01 and not any("few bits" in note for note in exact["notes"])


def test_a_folder_of_textures_is_pruned_and_converted(tmp_path, capsys):
    (tmp_path / "a").mkdir()
    write_scene(tmp_path / "a.ply", ball(1_000))
    with zipfile.ZipFile(
        io.BytesIO(by_gaussforge((tmp_path / "a.ply").read_bytes(), ".ply", ".sog"))
    ) as bundle:
        bundle.extractall(tmp_path / "a")
    assert prune(tmp_path / "a", "small.spz", quick=True)["before"]["bytes"] == sum(
        file.stat().st_size for file in (tmp_path / "a").iterdir()
    )
    assert main(["convert", str(tmp_path / "a"), str(tmp_path / "b.ply")]) == 0
    assert read_scene(tmp_path / "b.ply").count == 1_000
    assert main(["prune", str(tmp_path / "a"), "--quick", "--target", "0.5"]) == 0
    assert read_scene(tmp_path / "a_pruned.spz").count == 500


def test_the_quality_is_that_of_the_file(tmp_path):
    """Of steps so coarse that they show."""
    path = tmp_path / "ball.ply"
    write_scene(path, ball(1_000))
    plain, packed = (prune(path, out, quick=True) for out in ("a.ply", "a.splat"))
    assert packed["psnr"] < plain["psnr"] - 0.05
    original, scene = load_scene(path), load_scene(tmp_path / "a.splat")
    camera = cameras_around(original, 16, 512, turn=1.0, nearer=0.9)[3]
    images = [Rasterizer().forward(some, camera)["rgb"].copy() for some in (original, scene)]
    assert psnr(*images) == pytest.approx(packed["psnr"], abs=4)


@pytest.mark.slow
def test_a_fine_tuned_job_measures_what_it_wrote(tmp_path):
    path = tmp_path / "ball.ply"
    write_scene(path, ball(1_000))
    plain, packed = (prune(path, out, target=0.25, recovery=40) for out in ("b.ply", "b.splat"))
    assert packed["psnr"] != plain["psnr"]
    assert packed["count"] == plain["count"] == read_scene(tmp_path / "b.splat").count
    assert packed["after"]["bytes"] == 32 * packed["count"]


@pytest.mark.slow
def test_levels_are_written_in_the_format_of_the_output_and_a_nested_result_needs_its_order(tmp_path):
    path = tmp_path / "ball.ply"
    write_scene(path, ball(1_000))
    result = prune(path, "c.spz", target=0.5, recovery=20, levels=(0.5,))
    assert [read_scene(level["out"]).count for level in result["levels"]] == [250]
    assert result["levels"][0]["out"].endswith(".spz")
    with pytest.raises(SceneError, match=r"write a .*\.splat"):
        prune(path, "d.spz", target=0.5, recovery=20, nested=0.25)
    assert prune(path, "d.splat", target=0.5, recovery=20, nested=0.25)["count"] == 500
    assert np.isfinite(result["psnr"])


def test_a_format_that_loses_most_is_told_without_photographs_too(tmp_path):
    scene = ball(1_000)
    # an SPZ holds values from -1 to 1
    scene.sh[:, 1:] = np.random.default_rng(0).normal(0, 2, scene.sh[:, 1:].shape)
    write_scene(tmp_path / "a.ply", scene)
    short = {"iterations": 20, "recovery": 20, "target": 0.98}
    told = {suffix: prune(tmp_path / "a.ply", f"o{suffix}", **short)["notes"] for suffix in (".ply", ".spz")}
    found = {
        suffix: any("the format of the output loses" in note for note in notes)
        for suffix, notes in told.items()
    }
    assert found == {".ply": False, ".spz": True}
