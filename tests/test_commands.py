"""The command line: what info, render, eval, train and compare write and print."""

from __future__ import annotations

import json
import os
import re
import shutil
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
import tiny_dataset
from command_checks import MEASURES, TEST_VIEWS, files
from svrgs_addon.cli import commands
from svrgs_addon.files.images import read_image
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import FORMATS, load_scene, size_on_disk
from svrgs_addon.native.outputs import PICTURES
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.views.cameras_json import write_cameras_json


def truth_file(tiny, folder: Path) -> Path:
    """The scene the photographs show, as a file."""
    write_ply(folder / "truth.ply", tiny.truth)
    return folder / "truth.ply"


# --- info


def test_info(tiny, svrgs):
    facts = svrgs("info", tiny.splat, "--json").json
    expected = dict(count=tiny_dataset.COUNT, sh_degree=1, format="ply", bytes=tiny.splat.stat().st_size)
    assert facts.items() >= (expected | {"invisible": tiny_dataset.FAINT, "nonfinite": 0}).items()
    text = svrgs("info", tiny.splat).out
    assert re.search(rf"^count +{tiny_dataset.COUNT}$", text, re.MULTILINE)


def test_info_counts_what_is_not_finite(tiny, svrgs, tmp_path):
    means = tiny.truth.means.copy()
    means[3, 1] = np.nan
    write_ply(tmp_path / "bad.ply", replace(tiny.truth, means=means))
    facts = svrgs("info", tmp_path / "bad.ply", "--json").json
    assert (facts["count"], facts["nonfinite"]) == (tiny_dataset.SEEN, 1)
    assert np.isfinite(facts["bounds"]).all()


@pytest.mark.parametrize(
    "found",
    [
        pytest.param(found, marks=[pytest.mark.slow] if found.name == "usd" else [], id=found.name)
        for found in FORMATS
        if found.write
    ],
)
def test_every_format_is_read_and_written(tiny, svrgs, tmp_path, found):
    """From the columns of a 3DGS file, of which a format may have to leave some out."""
    first, second = (
        tmp_path / (f"{name}{found.suffixes[0]}" if found.suffixes else f"{name}/{found.index}")
        for name in "ab"
    )
    cut = f"--data {tiny.folder} --method opacity --recovery 0 --quiet --json --target-count"
    for count, path, out in ((60, tiny.splat, first), (50, first, second)):
        assert svrgs("prune", path, cut, count, "--out", out).json["count"] == count
        facts = svrgs("info", out, "--json").json
        assert (facts["count"], facts["format"], facts["bytes"]) == (count, found.name, size_on_disk(out))


# --- render


def test_render_npy_is_the_rasterizer_s_output(tiny, svrgs, tmp_path_factory, tmp_path):
    bright = replace(tiny.truth, sh=3 * tiny.truth.sh)  # above 1 in places, which nothing may clamp
    splat = tmp_path_factory.mktemp("bright") / "bright.ply"
    write_ply(splat, bright)
    words = ("--outputs", ",".join(PICTURES), "--format npy --views 03,7 --background 2e-1,0,1")
    result = svrgs("render", splat, "--data", tiny.folder, *words, "--out", tmp_path, "--json").json
    names = [f"{view}.{output}.npy" for view in ("03", "07") for output in PICTURES]
    assert result["files"] == [str(tmp_path / name) for name in names]
    assert sorted(files(tmp_path)) == sorted(names)
    options = RenderOptions(background=(0.2, 0, 1), mask_kind="svr")
    images = Rasterizer().forward(bright, tiny.cameras[7], options, outputs=PICTURES)
    for name, image in images.items():
        saved = np.load(tmp_path / f"07.{name}.npy")
        assert saved.dtype == np.float32 and saved.shape == image.shape
        assert np.allclose(saved, image, atol=1e-5)  # poses went through COLMAP's quaternions
    assert images["rgb"].max() > 1.1, "nothing here would show a clamp"


def test_render_needs_no_photographs(tiny, svrgs, tmp_path):
    shutil.copytree(tiny.folder / "sparse", tmp_path / "sparse")
    done = svrgs("render", tiny.splat, "--data", tmp_path, "--views", "test", "--out", tmp_path / "out")
    assert done.status == 0 and sorted(files(tmp_path / "out")) == [f"{view}.rgb.png" for view in TEST_VIEWS]
    assert done.out.splitlines() == [f"Saved: '{tmp_path / 'out' / view}.rgb.png'" for view in TEST_VIEWS]


def test_render_png_and_exr(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    for extension in ("png", "exr"):
        words = ("--outputs", ",".join(PICTURES), "--views", "05.png", "--format", extension)
        assert len(
            svrgs("render", truth, "--data", tiny.folder, *words, "--out", tmp_path, "--json").json["files"]
        ) == len(PICTURES)
    photo = read_image(tiny.folder / "images/05.png")
    assert np.abs(read_image(tmp_path / "05.rgb.png") - photo).max() <= 1 / 255 + 1e-6
    assert np.abs(read_image(tmp_path / "05.rgb.exr") - photo).max() <= 0.51 / 255
    assert read_image(tmp_path / "05.mask.png").std() > 0.05
    assert read_image(tmp_path / "05.depth.png").max() == 1


def cameras_json(tiny, folder: Path, names: list[str] | None = None) -> Path:
    entries = [
        {
            "img_name": name, "width": camera.width, "height": camera.height,
            "position": camera.position.tolist(), "rotation": camera.viewmat[:3, :3].T.tolist(),
            "fx": camera.K[0, 0], "fy": camera.K[1, 1],
        }
        for name, camera in zip(names or [camera.name for camera in tiny.cameras], tiny.cameras, strict=False)
    ]  # fmt: skip
    (folder / "cameras.json").write_text(json.dumps(entries))
    return folder / "cameras.json"


def test_render_from_cameras_json_with_folders_in_names(tiny, svrgs, tmp_path):
    cameras = cameras_json(tiny, tmp_path, ["right/a.png", "left/a.png", "left/b.0012"])
    done = svrgs("render", tiny.splat, "--cameras", cameras, "--format", "npy", "--out", tmp_path / "json")
    assert done.status == 0, done.err
    assert sorted(files(tmp_path / "json")) == ["left/a.rgb.npy", "left/b.0012.rgb.npy", "right/a.rgb.npy"]
    assert (
        svrgs(
            "render", tiny.splat, "--data", tiny.folder, "--format", "npy", "--out", tmp_path / "data"
        ).status
        == 0
    )
    for name, other in (("right/a", "00"), ("left/a", "01"), ("left/b.0012", "02")):
        assert np.allclose(
            np.load(tmp_path / f"json/{name}.rgb.npy"), np.load(tmp_path / f"data/{other}.rgb.npy"), atol=1e-5
        )


def test_render_along_parallel_rays(tiny, svrgs, tmp_path):
    path = cameras_json(tiny, tmp_path, ["flat"])
    (entry,) = json.loads(path.read_text())
    path.write_text(json.dumps([entry | {"orthographic": True, "fx": 12.0, "fy": 11.0}]))
    done = svrgs("render", tiny.splat, "--cameras", path, "--format", "npy", "--out", tmp_path / "out")
    assert done.status == 0, done.err
    first = tiny.cameras[0]
    K = np.array([[12, 0, first.width / 2], [0, 11, first.height / 2], [0, 0, 1]])
    expected = Rasterizer().forward(load_scene(tiny.splat), replace(first, K=K, orthographic=True))["rgb"]
    np.testing.assert_allclose(np.load(tmp_path / "out/flat.rgb.npy"), expected, atol=1e-5)
    assert expected.std() > 0.05


def test_render_train_and_test_views_are_all_views(tiny, svrgs, tmp_path):
    for views in ("train", "test"):
        assert (
            svrgs(
                "render", tiny.splat, "--data", tiny.folder, "--views", views, "--out", tmp_path / views
            ).status
            == 0
        )
    test, train = (set(files(tmp_path / views)) for views in ("test", "train"))
    assert test == {f"{view}.rgb.png" for view in TEST_VIEWS}
    assert train == {f"{i:02}.rgb.png" for i in range(tiny_dataset.VIEWS)} - test


# --- eval


def test_eval_of_the_truth_is_perfect(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    result = svrgs("eval", truth, "--data", tiny.folder, "--split", "all", "--json").json
    assert result.keys() == MEASURES | {"notes"}
    assert result["psnr"] is None or result["psnr"] > 60  # equal images: infinite, which JSON has not
    assert result["ssim"] > 0.9999 and result["flip"] < 1e-3 and result["lpips"] is None
    assert (result["count"], result["bytes"]) == (tiny_dataset.SEEN, truth.stat().st_size)
    assert result["ms_per_frame"] > 0


def test_eval_splits_add_up(tiny, svrgs):
    test, train, whole = (
        svrgs("eval", tiny.splat, "--data", tiny.folder, "--split", split, "--json").json
        for split in ("test", "train", "all")
    )
    share = len(TEST_VIEWS) / tiny_dataset.VIEWS
    for name in ("psnr", "ssim", "flip"):
        assert whole[name] == pytest.approx(share * test[name] + (1 - share) * train[name])
        assert test[name] != train[name]
    one = svrgs("eval", tiny.splat, "--data", tiny.folder, "--holdout", tiny_dataset.VIEWS, "--json").json
    assert one["psnr"] != test["psnr"]


def test_eval_says_why_lpips_is_left_out(tiny, svrgs):
    assert (
        "LPIPS left out: no LPIPS weights: give --lpips-weights"
        in svrgs("eval", tiny.splat, "--data", tiny.folder).out
    )


# --- train


@pytest.mark.parametrize("method", ["3dgs", "removal"])
def test_train_from_sparse_points(tiny, svrgs, tmp_path, method):
    words = ("--method", method, "--iterations", 150, "--recovery", 20, "--sh-degree", 1, "--quiet", "--json")
    result = svrgs("train", "--data", tiny.folder, *words, "--out", tmp_path / "trained.ply").json
    assert MEASURES | {"seconds", "method", "lambda_f", "out"} <= result.keys()
    assert list(files(tmp_path)) == ["trained.ply"]
    scene = read_ply(tmp_path / "trained.ply")
    assert (scene.count, scene.sh_degree, result["iterations"]) == (result["count"], 1, 170)
    assert result["psnr"] > 15, "training does not approach the photographs"


# --- compare


def test_compare(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    result = svrgs(
        "compare", tiny.splat, truth, "--data", tiny.folder, "--out", tmp_path / "out", "--json"
    ).json
    assert result["a"].keys() == result["b"].keys() == MEASURES
    assert (result["a"]["count"], result["b"]["count"]) == (tiny_dataset.COUNT, tiny_dataset.SEEN)
    assert sorted(files(tmp_path / "out")) == [f"{view}.png" for view in TEST_VIEWS] + ["index.html"]
    assert result["report"] == str(tmp_path / "out/index.html")
    strip = read_image(tmp_path / "out/00.png")
    assert strip.shape == (tiny_dataset.HEIGHT, 5 * tiny_dataset.WIDTH, 3)
    a, b, difference = (strip[:, k * tiny_dataset.WIDTH : (k + 1) * tiny_dataset.WIDTH] for k in range(3))
    assert np.abs(difference - np.clip(4 * np.abs(a - b), 0, 1)).max() <= 5 / 255
    assert np.abs(b - read_image(tiny.folder / "images/00.png")).max() <= 1 / 255 + 1e-6
    page = (tmp_path / "out/index.html").read_text("utf-8")
    assert "scene.ply" in page and "truth.ply" in page and "data:image/" in page


def test_compare_without_photographs(tiny, svrgs, tmp_path):
    """B against pictures of A."""
    write_cameras_json(tmp_path / "cameras.json", tiny_dataset.views()[:5])
    words = ["compare", tiny.splat, truth_file(tiny, tmp_path), f"--cameras {tmp_path}/cameras.json --out"]
    result = svrgs(*words, tmp_path / "out", "--json").json
    assert result["a"].keys() == {"count", "bytes", "ms_per_frame"} and result["b"].keys() == MEASURES
    assert len(result["pictures"]) == 3
    assert (
        "truth.ply is measured against pictures of scene.ply, in 5 views from cameras.json"
        in result["notes"][0]
    )
    same = svrgs("compare", tiny.splat, tiny.splat, *words[3:], tmp_path / "same", "--json").json["b"]
    assert same["psnr"] is None and same["flip"] == 0 and 15 < result["b"]["psnr"] < 40
    assert "no photographs" in (tmp_path / "out/index.html").read_text("utf-8")
    said = svrgs(*words, tmp_path / "text").out
    assert said.startswith(f"a: {tiny_dataset.COUNT} Gaussians, ") and "PSNR" in said.splitlines()[1]
    assert "no photographs" in said


def test_cameras_that_do_not_suit_a_comparison_are_refused(tiny, svrgs, tmp_path):
    first, second = tiny_dataset.views()[:2]
    # they look away
    behind = [
        replace(camera, viewmat=np.diag([-1.0, 1, -1, 1]) @ camera.viewmat) for camera in (first, second)
    ]
    for cameras, sentence in (
        ([first, replace(second, name="00.jpg")], "give one of the cameras another name"),
        (behind, "use the cameras of this scene"),
    ):
        write_cameras_json(tmp_path / "cameras.json", cameras)
        refused = svrgs(
            f"compare {tiny.splat} {tiny.splat} --cameras {tmp_path}/cameras.json --out {tmp_path}/out"
        )
        assert refused.status == 2 and sentence in refused.err and not (tmp_path / "out").exists()


@pytest.mark.slow
def test_views_of_a_comparison_are_placed(tiny, svrgs, tmp_path):
    write_ply(tmp_path / "ball.ply", scenes.ball(1_000))
    write_ply(tmp_path / "half.ply", scenes.ball(500))
    result = svrgs(
        "compare", tmp_path / "ball.ply", tmp_path / "half.ply", "--out", tmp_path / "out", "--json"
    ).json
    assert "views that were placed" in result["notes"][0] and 5 < result["b"]["psnr"] < 35
    refused = svrgs(
        "compare", tmp_path / "ball.ply", tmp_path / "half.ply", "--holdout", 4, "--out", tmp_path / "no"
    )
    assert refused.status == 2 and "give --data, or leave it out" in refused.err
    assert not (tmp_path / "no").exists()


def test_a_comparison_is_refused_before_views_are_placed(tiny, svrgs, tmp_path, monkeypatch):
    monkeypatch.setattr(
        "svrgs_addon.cli.compare_scenes.place_rig", lambda *_, **__: pytest.fail("views were placed")
    )
    both = svrgs(
        f"compare {tiny.splat} {tiny.splat} --data {tiny.folder} --cameras {tmp_path}/cameras.json",
        f"--out {tmp_path}/no",
    )
    assert both.status == 2 and "both name views" in both.err and not (tmp_path / "no").exists()
    (tmp_path / "file").touch()
    assert "is not a folder" in svrgs("compare", tiny.splat, tiny.splat, "--out", tmp_path / "file/out").err


# --- failures and help


def test_failures_that_are_nobody_s_input_exit_1(tiny, svrgs, monkeypatch):
    def out_of_memory(*_):
        raise MemoryError

    monkeypatch.setattr(commands.registry, "describe", out_of_memory)
    done = svrgs("info", tiny.splat)
    assert (done.status, done.out, done.err) == (1, "", "svrgs: out of memory\n")


@pytest.mark.parametrize(
    "command", ["info", "render", "train", "prune", "eval", "compare", "methods", "bench"]
)
def test_every_command_has_help_in_any_encoding(command):
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run(
        [sys.executable, "-m", "svrgs_addon", command, "--help"],
        cwd=Path(__file__).resolve().parents[1],
        env=environment,
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith(f"usage: svrgs {command}")


def test_help_and_version(svrgs):
    assert svrgs("--help").status == svrgs("prune", "--help").status == 0
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", svrgs("--version").out)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="no named pipes")
def test_a_pipe_is_not_waited_for(svrgs, tmp_path):
    os.mkfifo(tmp_path / "pipe.ply")
    for words in (("info",), ("prune", "--quick", "--target", 0.5)):
        found = svrgs(words[0], tmp_path / "pipe.ply", *words[1:])
        assert found.status == 2 and "is a pipe or a device, not a file" in found.err
