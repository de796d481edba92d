"""The command line: what each command writes and prints, and one sentence and exit 2 for whatever does not fit."""

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

import tiny_dataset
from svrgs_addon.cli import commands
from svrgs_addon.files.images import read_image
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.files.registry import load_scene
from svrgs_addon.finetune import scores
from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.jobs import train_and_prune
from svrgs_addon.metrics.evaluate import render_options
from svrgs_addon.native import Rasterizer, RenderOptions

ROOT = Path(__file__).resolve().parents[1]
MEASURES = {"psnr", "ssim", "lpips", "flip", "count", "bytes", "ms_per_frame"}
SHORT = ("--iterations", 8, "--recovery", 4, "--quiet")
TEST_VIEWS = ["00", "08"]


def truth_file(tiny, folder: Path) -> Path:
    """The scene the photographs show, as a file."""
    write_ply(folder / "truth.ply", tiny.truth)
    return folder / "truth.ply"


def measures(result: dict) -> dict:
    """The part of a result that is the same for every run."""
    return {name: result[name] for name in MEASURES - {"ms_per_frame"}}


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}


# --- info


def test_info(tiny, svrgs):
    facts = svrgs("info", tiny.splat, "--json").json
    expected = {"count": tiny_dataset.COUNT, "sh_degree": 1, "format": "ply", "bytes": tiny.splat.stat().st_size}
    assert facts.items() >= (expected | {"invisible": tiny_dataset.FAINT, "nonfinite": 0}).items()
    text = svrgs("info", tiny.splat).out
    assert re.search(rf"^count +{tiny_dataset.COUNT}$", text, re.MULTILINE)


def test_info_counts_what_is_not_finite(tiny, svrgs, tmp_path):
    means = tiny.truth.means.copy()
    means[3, 1] = np.nan
    write_ply(tmp_path / "bad.ply", replace(tiny.truth, means=means))
    facts = svrgs("info", tmp_path / "bad.ply", "--json").json
    assert (facts["count"], facts["nonfinite"]) == (tiny_dataset.SEEN, 1) and np.isfinite(facts["bounds"]).all()


# --- render


def test_render_npy_is_the_rasterizer_s_output(tiny, svrgs, tmp_path_factory, tmp_path):
    bright = replace(tiny.truth, sh=3 * tiny.truth.sh)  # above 1 in places, which nothing may clamp
    splat = tmp_path_factory.mktemp("bright") / "bright.ply"
    write_ply(splat, bright)
    words = ("--outputs", "rgb,mask,depth,alpha", "--format", "npy", "--views", "03,7", "--background", "2e-1,0,1")
    result = svrgs("render", splat, "--colmap", tiny.folder, *words, "--out", tmp_path, "--json").json
    names = [f"{view}.{output}.npy" for view in ("03", "07") for output in ("rgb", "mask", "depth", "alpha")]
    assert result["files"] == [str(tmp_path / name) for name in names] and sorted(files(tmp_path)) == sorted(names)
    options = RenderOptions(background=(0.2, 0, 1), mask_kind="svr")
    images = Rasterizer().forward(bright, tiny.cameras[7], options, outputs=("rgb", "mask", "depth", "alpha"))
    for name, image in images.items():
        saved = np.load(tmp_path / f"07.{name}.npy")
        assert saved.dtype == np.float32 and saved.shape == image.shape
        assert np.allclose(saved, image, atol=1e-5)  # poses went through COLMAP's quaternions
    assert images["rgb"].max() > 1.1, "nothing here would show a clamp"


def test_render_needs_no_photographs(tiny, svrgs, tmp_path):
    shutil.copytree(tiny.folder / "sparse", tmp_path / "sparse")
    done = svrgs("render", tiny.splat, "--colmap", tmp_path, "--views", "test", "--out", tmp_path / "out")
    assert done.status == 0 and sorted(files(tmp_path / "out")) == [f"{view}.rgb.png" for view in TEST_VIEWS]
    assert done.out.splitlines() == [f"Saved: '{tmp_path / 'out' / view}.rgb.png'" for view in TEST_VIEWS]


def test_render_png_and_exr(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    for extension in ("png", "exr"):
        words = ("--outputs", "rgb,mask,depth,alpha", "--views", "05.png", "--format", extension)
        assert len(svrgs("render", truth, "--colmap", tiny.folder, *words, "--out", tmp_path, "--json").json["files"]) == 4
    photo = read_image(tiny.folder / "images/05.png")
    assert np.abs(read_image(tmp_path / "05.rgb.png") - photo).max() <= 1 / 255 + 1e-6
    assert np.abs(read_image(tmp_path / "05.rgb.exr") - photo).max() <= 0.51 / 255
    assert read_image(tmp_path / "05.mask.png").std() > 0.05 and read_image(tmp_path / "05.depth.png").max() == 1


def cameras_json(tiny, folder: Path, names: list[str] | None = None) -> Path:
    entries = [
        {
            "img_name": name, "width": camera.width, "height": camera.height, "position": camera.position.tolist(),
            "rotation": camera.viewmat[:3, :3].T.tolist(), "fx": camera.K[0, 0], "fy": camera.K[1, 1],
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
    assert svrgs("render", tiny.splat, "--colmap", tiny.folder, "--format", "npy", "--out", tmp_path / "colmap").status == 0
    for name, other in (("right/a", "00"), ("left/a", "01"), ("left/b.0012", "02")):
        assert np.allclose(np.load(tmp_path / f"json/{name}.rgb.npy"), np.load(tmp_path / f"colmap/{other}.rgb.npy"), atol=1e-5)


def test_render_along_parallel_rays(tiny, svrgs, tmp_path):
    path = cameras_json(tiny, tmp_path, ["flat"])
    (entry,) = json.loads(path.read_text())
    path.write_text(json.dumps([entry | {"orthographic": True, "fx": 12.0, "fy": 11.0}]))
    done = svrgs("render", tiny.splat, "--cameras", path, "--format", "npy", "--out", tmp_path / "out")
    assert done.status == 0, done.err
    first = tiny.cameras[0]
    K = np.array([[12, 0, first.width / 2], [0, 11, first.height / 2], [0, 0, 1]])
    expected = Rasterizer().forward(load_scene(tiny.splat).scene, replace(first, K=K, orthographic=True))["rgb"]
    np.testing.assert_allclose(np.load(tmp_path / "out/flat.rgb.npy"), expected, atol=1e-5)
    assert expected.std() > 0.05


def test_render_train_and_test_views_are_all_views(tiny, svrgs, tmp_path):
    for views in ("train", "test"):
        assert svrgs("render", tiny.splat, "--colmap", tiny.folder, "--views", views, "--out", tmp_path / views).status == 0
    test, train = (set(files(tmp_path / views)) for views in ("test", "train"))
    assert test == {f"{view}.rgb.png" for view in TEST_VIEWS}
    assert train == {f"{i:02}.rgb.png" for i in range(tiny_dataset.VIEWS)} - test


# --- eval


def test_eval_of_the_truth_is_perfect(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    result = svrgs("eval", truth, "--colmap", tiny.folder, "--split", "all", "--json").json
    assert result.keys() == MEASURES
    assert result["psnr"] is None or result["psnr"] > 60  # equal images: infinite, which JSON has not
    assert result["ssim"] > 0.9999 and result["flip"] < 1e-3 and result["lpips"] is None
    assert (result["count"], result["bytes"]) == (tiny_dataset.SEEN, truth.stat().st_size) and result["ms_per_frame"] > 0


def test_eval_splits_add_up(tiny, svrgs):
    test, train, whole = (svrgs("eval", tiny.splat, "--colmap", tiny.folder, "--split", split, "--json").json for split in ("test", "train", "all"))
    share = len(TEST_VIEWS) / tiny_dataset.VIEWS
    for name in ("psnr", "ssim", "flip"):
        assert whole[name] == pytest.approx(share * test[name] + (1 - share) * train[name])
        assert test[name] != train[name]
    one = svrgs("eval", tiny.splat, "--colmap", tiny.folder, "--holdout", tiny_dataset.VIEWS, "--json").json
    assert one["psnr"] != test["psnr"]


def test_eval_says_why_lpips_is_left_out(tiny, svrgs):
    assert "LPIPS left out: no LPIPS weight file was given" in svrgs("eval", tiny.splat, "--colmap", tiny.folder).out


# --- prune


@pytest.fixture(scope="module")
def pruned(tiny, tmp_path_factory) -> dict:
    """Result of one real pruning run with a report; 'folder' beside its keys."""
    folder = tmp_path_factory.mktemp("pruned")
    words = ["prune", tiny.splat, "--colmap", tiny.folder, "--iterations", 300, "--recovery", 200, "--target", 0.4, "--json"]
    command = [sys.executable, "-m", "svrgs_addon", *words, "--out", folder / "small.ply", "--report", folder / "report"]
    done = subprocess.run([str(word) for word in command], cwd=ROOT, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    assert re.search(r"recover 500/500 .* Gaussians", done.stderr), "progress belongs on stderr"
    assert done.stdout.count("\n") == 1
    return {"folder": folder, **json.loads(done.stdout)}


def test_prune_result(tiny, pruned):
    assert MEASURES | {"before", "after", "seconds", "method", "lambda_f", "out"} <= pruned.keys()
    assert pruned["before"].keys() == pruned["after"].keys() == MEASURES
    assert (pruned["method"], pruned["lambda_f"]) == ("pressure", None), "the target says how many stay"
    assert tiny_dataset.FAINT <= pruned["first_cut"] < tiny_dataset.COUNT
    assert pruned["count"] == round(0.4 * tiny_dataset.COUNT) and pruned["before"]["count"] == tiny_dataset.COUNT
    assert pruned["psnr"] > pruned["before"]["psnr"] + 1, "fine-tuning does not fit the photographs"
    assert sorted(files(pruned["folder"])) == ["report/index.html", "small.ply"]


def test_prune_measures_what_eval_measures(tiny, pruned, svrgs):
    for scene, part in ((pruned["out"], "after"), (tiny.splat, "before")):
        assert measures(svrgs("eval", scene, "--colmap", tiny.folder, "--json").json) == pytest.approx(measures(pruned[part]), rel=1e-12)
    assert measures(pruned) == measures(pruned["after"])


def test_pruned_file_keeps_the_form_of_its_source(tiny, pruned):
    source, small = read_ply(tiny.splat), read_ply(pruned["out"])
    assert (small.count, small.sh_degree, small.antialiased) == (pruned["count"], source.sh_degree, source.antialiased)
    assert small.property_order == source.property_order and small.attributes.keys() == source.attributes.keys()


def test_report_is_one_page_with_table_plots_and_pictures(pruned):
    page = (pruned["folder"] / "report/index.html").read_text()
    assert "no LPIPS weight file was given" in page
    assert f"{pruned['before']['psnr']:.2f} dB" in page and f"{pruned['psnr']:.2f} dB" in page
    assert page.count("<svg") >= 3 and len(re.findall('src="data:image/[a-z]+;base64,', page)) == 6 * len(TEST_VIEWS)
    assert not re.search(r'(src|href)="(?!data:)', page) and "http-equiv" in page and "@import" not in page


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if not method.ranks and not method.share])
def test_every_method_runs(tiny, svrgs, tmp_path, method):
    result = svrgs("prune", tiny.splat, "--colmap", tiny.folder, "--method", method, *SHORT, "--out", tmp_path / "o.ply", "--json").json
    assert result["method"] == method and result["lambda_f"] == (METHODS[method].lambda_f or None)
    left = tiny_dataset.COUNT - result["first_cut"]
    assert result["count"] < left if method in ("pressure", "saliency") else result["count"] == left, "masks cannot have learned in so few steps"
    assert result["first_cut"] > tiny_dataset.FAINT if METHODS[method].learns_masks else result["first_cut"] == tiny_dataset.FAINT
    assert result["iterations"] == (4 if method == "3dgs" else 12)


@pytest.mark.parametrize("method", [name for name, method in METHODS.items() if method.ranks or method.share])
def test_every_method_with_a_budget_prunes_to_it(tiny, svrgs, tmp_path, method):
    """Asked for, or its own where it has one."""
    for target in (("--target-count", 70), ("--target", 0.5), ()):
        words = ("prune", tiny.splat, "--colmap", tiny.folder, "--method", method, *target, *SHORT, "--out", tmp_path / "o.ply", "--json")
        if not target and not METHODS[method].share:
            refused(svrgs(*words), f"method '{method}' needs --target")
            continue
        share = METHODS[method].share or 0.5
        expected = {"--target-count": 70, "--target": tiny_dataset.COUNT // 2}.get(target and target[0], round(share * tiny_dataset.COUNT))
        assert svrgs(*words).json["count"] == expected


@pytest.mark.parametrize("method", [name for name in METHODS if name != "3dgs"])
def test_every_method_trains_to_a_share(tiny, svrgs, tmp_path, method):
    """Of the Gaussians there are when densification ends: here of the sparse points, which none has multiplied."""
    words = ("--method", method, "--target", 0.5, "--iterations", 60, "--recovery", 5, "--sh-degree", 0, "--densify-until", 20, "--quiet", "--json")
    result = svrgs("train", "--colmap", tiny.folder, *words, "--out", tmp_path / "o.ply").json
    assert result["count"] == result["target"] == tiny_dataset.SEEN // 2 and result["iterations"] == 65


def test_the_papers_form_is_chosen_by_a_flag(tiny, svrgs, tmp_path):
    words = ("--colmap", tiny.folder, "--paper", "--method", "svr", *SHORT, "--out", tmp_path / "o.ply", "--json")
    result = svrgs("prune", tiny.splat, *words).json
    assert (result["method"], result["lambda_f"], result["first_cut"]) == ("svr-paper", 1e-4, tiny_dataset.FAINT)
    refused(svrgs("prune", tiny.splat, *words, "--method", "maskgs"), "--paper", "'maskgs'")
    refused(svrgs("prune", tiny.splat, "--colmap", tiny.folder, "--method", "svr-paper", "--out", tmp_path / "p.ply"), "unknown")


def test_help_lists_every_method(svrgs):
    for command in ("train", "prune"):
        lines = svrgs(command, "--help").out.split("methods:\n")[1].splitlines()
        assert [line.split()[0] for line in lines if line[2] != " "] == list(METHODS)


def test_opacity_keeps_the_most_opaque(tiny, svrgs, tmp_path):
    words = ("--method", "opacity", "--target-count", 50, "--recovery", 0, "--quiet", "--json")
    assert svrgs("prune", tiny.splat, "--colmap", tiny.folder, *words, "--out", tmp_path / "o.ply").json["count"] == 50
    logits = read_ply(tiny.splat).opacity_logits
    assert np.array_equal(np.sort(read_ply(tmp_path / "o.ply").opacity_logits), np.sort(logits)[-50:])


def test_contribution_keeps_what_contributes_most(tiny, svrgs, tmp_path):
    words = ("--method", "contribution", "--target", 0.2, "--recovery", 0, "--quiet", "--json")
    assert svrgs("prune", tiny.splat, "--colmap", tiny.folder, *words, "--out", tmp_path / "o.ply").json["count"] == 50
    scene = read_ply(tiny.splat)
    train = [camera for i, camera in enumerate(tiny.cameras) if i % 8]
    sums, _, _ = scores.contribution(scene, train, Rasterizer(), render_options(scene))
    expected = scene.means[np.sort(np.argsort(-sums)[:50])]
    assert np.array_equal(read_ply(tmp_path / "o.ply").means, expected)


def first_cut(tiny, svrgs, out: Path, *words: object) -> dict:
    """Result of a pruning run that takes no step."""
    words = ("--iterations", 0, "--recovery", 0, "--quiet", "--json", *words)
    return svrgs("prune", tiny.splat, "--colmap", tiny.folder, *words, "--out", out).json


def test_the_first_cut_drops_what_contributes_little_to_every_training_view(tiny, svrgs, tmp_path):
    result = first_cut(tiny, svrgs, tmp_path / "o.ply", "--min-contribution", 0.3)
    scene = read_ply(tiny.splat)
    train = [camera for i, camera in enumerate(tiny.cameras) if i % 8]
    _, peaks, _ = scores.contribution(scene, train, Rasterizer(), render_options(scene))
    assert 10 < result["count"] == (peaks >= 0.3).sum() < 200 and result["first_cut"] == tiny_dataset.COUNT - result["count"]
    assert np.array_equal(read_ply(tmp_path / "o.ply").means, scene.means[peaks >= 0.3])


def test_the_first_cut_spares_enough_for_a_target(tiny, svrgs, tmp_path):
    words = ("--min-contribution", 0.9, "--iterations", 2, "--recovery", 0, "--target-count", 200, "--quiet", "--json")
    assert svrgs("prune", tiny.splat, "--colmap", tiny.folder, *words, "--out", tmp_path / "o.ply").json["count"] == 200


def test_only_the_invisible_goes_where_nothing_else_is_asked_for(tiny, svrgs, tmp_path):
    result = first_cut(tiny, svrgs, tmp_path / "o.ply", "--min-contribution", 0)
    assert result["count"] == tiny_dataset.COUNT - tiny_dataset.FAINT and result["psnr"] == result["before"]["psnr"]


def test_a_scene_that_would_lose_everything_is_refused(tiny, svrgs, tmp_path):
    words = ("--lambda-f", 1e9, "--iterations", 2500, "--recovery", 0, "--quiet")
    done = svrgs("prune", tiny.splat, "--colmap", tiny.folder, *words, "--out", tmp_path / "o.ply", "--report", tmp_path / "report")
    refused(done, "pruning would leave", "smaller lambda-f")
    assert not list(tmp_path.iterdir())


# --- train


@pytest.mark.parametrize("method", ["3dgs", "pressure"])
def test_train_from_sparse_points(tiny, svrgs, tmp_path, method):
    words = ("--method", method, "--iterations", 150, "--recovery", 20, "--sh-degree", 1, "--quiet", "--json")
    result = svrgs("train", "--colmap", tiny.folder, *words, "--out", tmp_path / "trained.ply").json
    assert MEASURES | {"seconds", "method", "lambda_f", "out"} <= result.keys() and list(files(tmp_path)) == ["trained.ply"]
    scene = read_ply(tmp_path / "trained.ply")
    assert (scene.count, scene.sh_degree, result["iterations"]) == (result["count"], 1, 170)
    assert result["psnr"] > 15, "training does not approach the photographs"


# --- compare


def test_compare(tiny, svrgs, tmp_path):
    truth = truth_file(tiny, tmp_path)
    result = svrgs("compare", tiny.splat, truth, "--colmap", tiny.folder, "--out", tmp_path / "out", "--json").json
    assert result["a"].keys() == result["b"].keys() == MEASURES
    assert (result["a"]["count"], result["b"]["count"]) == (tiny_dataset.COUNT, tiny_dataset.SEEN)
    assert sorted(files(tmp_path / "out")) == [f"{view}.png" for view in TEST_VIEWS] + ["index.html"]
    assert result["report"] == str(tmp_path / "out/index.html")
    strip = read_image(tmp_path / "out/00.png")
    assert strip.shape == (tiny_dataset.HEIGHT, 5 * tiny_dataset.WIDTH, 3)
    a, b, difference = (strip[:, k * tiny_dataset.WIDTH : (k + 1) * tiny_dataset.WIDTH] for k in range(3))
    assert np.abs(difference - np.clip(4 * np.abs(a - b), 0, 1)).max() <= 5 / 255
    assert np.abs(b - read_image(tiny.folder / "images/00.png")).max() <= 1 / 255 + 1e-6
    page = (tmp_path / "out/index.html").read_text()
    assert "scene.ply" in page and "truth.ply" in page and "data:image/" in page


# --- what does not fit


def refused(done, *words: str):
    """Exit 2, nothing on stdout, one line on stderr that holds the words."""
    assert (done.status, done.out) == (2, ""), done
    lines = [line for line in done.err.splitlines() if line.strip()]
    assert len(lines) == 1 and re.match("svrgs[a-z ]*: ", lines[0]), done.err
    assert all(word in lines[0] for word in words), done.err


@pytest.fixture
def work(tiny, tmp_path) -> Path:
    """A private copy of the tiny dataset, to be broken, with an ordinary file 'file' beside."""
    shutil.copytree(tiny.folder, tmp_path / "data")
    (tmp_path / "file").write_text("no folder")
    return tmp_path


def no_photographs(work: Path):
    for name in ("01.png", "04.png", "05.png", "09.png"):
        (work / "data/images" / name).unlink()


def no_image_folder(work: Path):
    shutil.rmtree(work / "data/images")


def no_model(work: Path):
    shutil.rmtree(work / "data/sparse")


def no_views(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(1), np.zeros((0, 3)))
    path = work / "data/sparse/0/images.bin"
    path.write_bytes(bytes(8))


def panorama(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(), np.zeros((9, 3)), "EQUIRECTANGULAR")


def one_view(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(1), np.zeros((9, 3)))


def no_points(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(), np.zeros((0, 3)))


def broken_photograph(work: Path):
    (work / "data/images/00.png").write_bytes(b"no image")


def truncated_splat(work: Path):
    path = work / "data/scene.ply"
    path.write_bytes(path.read_bytes()[:-100])


def splat_elsewhere(work: Path):
    scene = read_ply(work / "data/scene.ply")
    write_ply(work / "data/scene.ply", replace(scene, means=scene.means + np.float32(1e4)))


def empty_splat(work: Path):
    scene = read_ply(work / "data/scene.ply")
    write_ply(work / "data/scene.ply", scene.select(np.zeros(scene.count, bool)))


def same_stems(work: Path):
    cameras = [replace(camera, name=name) for camera, name in zip(tiny_dataset.views(2), ("a.png", "a.jpg"), strict=True)]
    tiny_dataset.write_colmap(work / "data/sparse/0", cameras, np.zeros((0, 3)))


def nothing(work: Path):
    pass


DATA = "--colmap {data}"
PRUNE = f"prune {{data}}/scene.ply {DATA} --quiet --out {{work}}/o.ply --report {{work}}/report"
TRAIN = f"train {DATA} --iterations 5 --quiet --out {{work}}/o.ply"
EVAL = f"eval {{data}}/scene.ply {DATA}"
RENDER = f"render {{data}}/scene.ply {DATA} --out {{work}}/out"
COMPARE = f"compare {{data}}/scene.ply {{data}}/scene.ply {DATA} --out {{work}}/out"

REFUSED = [  # what is broken, the command, what the sentence says
    *((no_photographs, command, ("4 of 12 photographs are missing: 01.png, 04.png, 05.png, ...",)) for command in (PRUNE, TRAIN, EVAL, COMPARE)),
    *((no_image_folder, command, ("no image folder",)) for command in (PRUNE, EVAL)),
    *((no_model, command, ("holds no COLMAP model",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *((no_views, command, ("no view with a pose",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *((panorama, command, ("EQUIRECTANGULAR",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *((truncated_splat, command, ("scene.ply", "is truncated")) for command in ("info {data}/scene.ply", PRUNE, EVAL, RENDER, COMPARE)),
    *((splat_elsewhere, command, ("scene.ply", "none of its Gaussians lies near")) for command in (PRUNE, EVAL, COMPARE)),
    *((empty_splat, command, ("scene.ply", "no usable Gaussian")) for command in (PRUNE, EVAL, RENDER, COMPARE)),
    *((broken_photograph, command, ("00.png", "cannot be read as an image")) for command in (PRUNE, EVAL)),
    (one_view, PRUNE, ("--holdout 0",)),
    (one_view, TRAIN, ("--holdout 0",)),
    (one_view, f"{EVAL} --split train", ("no train views",)),
    (one_view, f"{RENDER} --views train", ("no train views",)),
    (no_points, TRAIN, ("no 3-D points",)),
    (same_stems, RENDER, ("'a.jpg' and 'a.png'", "same files")),
    *((nothing, f"{command} --lpips-weights {{work}}/no.pt", ("--lpips-weights", "no.pt")) for command in (PRUNE, TRAIN, EVAL, COMPARE)),
    (nothing, f"{PRUNE} --method dropout", ("method 'dropout' is unknown", "svr, ")),
    (nothing, f"{TRAIN} --method dropout", ("method 'dropout' is unknown",)),
    (nothing, f"{TRAIN} --method opacity", ("needs --target",)),
    *((nothing, f"{PRUNE} --lambda-f={value}", ("--lambda-f", f"'{value}' is not a weight")) for value in ("-1", "nan", "inf", "much")),
    (nothing, f"{PRUNE} --method maskgs --lambda-f 1e-4", ("method 'maskgs' has no spatial mask",)),
    *((nothing, f"{PRUNE} --target {value}", ("--target", f"'{value}' is not a share")) for value in ("0", "1.5", "half")),
    (nothing, f"{PRUNE} --target 0.5 --target-count 9", ("not allowed with",)),
    (nothing, f"{PRUNE} --target-count 0", ("--target-count",)),
    (nothing, f"{PRUNE} --method opacity", ("needs --target",)),
    (nothing, f"{PRUNE} --method 3dgs --target 0.5", ("cannot reach a target",)),
    (nothing, f"{PRUNE} --iterations 0 --target 0.5", ("cannot reach a target",)),
    *((nothing, f"{PRUNE} --min-contribution {value}", ("--min-contribution",)) for value in ("1", "-1", "nan")),
    (nothing, f"{PRUNE} --min-contribution 0.9999", ("pruning would leave 0 of", "min-contribution")),
    (nothing, f"{PRUNE} --iterations -3", ("--iterations",)),
    (nothing, f"{PRUNE} --engine cuda", ("--engine",)),
    (nothing, f"{RENDER} --views 00,99", ("there is no view '99'", "0 to 11")),
    (nothing, f"{RENDER} --views \N{SUPERSCRIPT TWO}", ("there is no view",)),
    (nothing, f"{RENDER} --outputs rgb,normals", ("output 'normals' is unknown",)),
    (nothing, f"{RENDER} --format gif", ("--format",)),
    (nothing, f"{RENDER} --background 0,0,2", ("--background",)),
    (nothing, "render {data}/scene.ply --out {work}/out", ("--colmap", "--cameras")),
    (nothing, "render {data}/scene.ply --cameras {work}/file --out {work}/out", ("is not JSON",)),
    (nothing, "render {data}/scene.ply --cameras {work}/none.json --out {work}/out", ("none.json", "cannot be read")),
    (nothing, f"prune {{data}}/scene.ply {DATA} --out {{data}}/scene.ply", ("is the input itself",)),
    (nothing, f"prune {{work}}/file --out {{work}}/o.ply {DATA}", ("are not read",)),
    (nothing, f"prune {{work}}/none.ply --out {{work}}/o.ply {DATA}", ("there is no such file",)),
    (nothing, f"prune {{data}}/sparse --out {{work}}/o.ply {DATA}", ("holds no splat",)),
    (nothing, "info {work}/none.ply", ("there is no such file",)),
    (nothing, "info {work}", ("is a folder",)),
    (nothing, "paint", ("invalid choice",)),
    (nothing, "", ("COMMAND",)),
]


@pytest.mark.parametrize("damage, line, words", REFUSED, ids=lambda value: value.__name__ if callable(value) else None)
def test_bad_input_is_refused_and_nothing_written(work, svrgs, damage, line, words):
    damage(work)
    before = files(work)
    refused(svrgs(*line.format(work=work, data=work / "data").split()), *words)
    assert files(work) == before and sorted(path.name for path in work.iterdir()) == ["data", "file"]


UNWRITABLE = {
    "prune": "prune {scene} --colmap {data} --out {file}/o.ply",
    "prune, report": "prune {scene} --colmap {data} --out {work}/o.ply --report {file}",
    "prune, checkpoints": "prune {scene} --colmap {data} --out {work}/busy.ply",  # busy.ply.job is a file
    "prune, other suffix": "prune {scene} --colmap {data} --out {work}/o.splat",
    "train": "train --colmap {data} --out {file}/o.ply",
    "train, folder": "train --colmap {data} --out {work}",
    "render": "render {scene} --colmap {data} --out {file}",
    "compare": "compare {scene} {scene} --colmap {data} --out {file}/deeper",
}


@pytest.mark.parametrize("line", UNWRITABLE.values(), ids=UNWRITABLE)
def test_an_output_that_cannot_be_written_is_found_before_the_work(tiny, svrgs, tmp_path, monkeypatch, line):
    for module, name in ((train_and_prune, "load_scene"), (train_and_prune, "fine_tune"), (Rasterizer, "forward")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("the work has begun"))
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "busy.ply.job").write_text("no folder")
    before = files(tmp_path)
    words = line.format(scene=tiny.splat, data=tiny.folder, work=tmp_path, file=tmp_path / "file").split()
    refused(svrgs(*words), str(tmp_path))
    assert files(tmp_path) == before


def test_prune_without_photographs_asks_for_them(tiny, svrgs, tmp_path):
    scene = shutil.copy(tiny.splat, tmp_path / "alone.ply")
    refused(svrgs("prune", scene), "alone.ply", "--colmap")
    assert list(files(tmp_path)) == ["alone.ply"]


def test_failures_that_are_nobody_s_input_exit_1(tiny, svrgs, monkeypatch):
    def out_of_memory(*_):
        raise MemoryError

    monkeypatch.setattr(commands.registry, "describe", out_of_memory)
    done = svrgs("info", tiny.splat)
    assert (done.status, done.out, done.err) == (1, "", "svrgs: out of memory\n")


@pytest.mark.parametrize("command", ["info", "render", "train", "prune", "eval", "compare", "bench"])
def test_every_command_has_help_in_any_encoding(command):
    environment = os.environ | {"PYTHONIOENCODING": "ascii"}
    done = subprocess.run([sys.executable, "-m", "svrgs_addon", command, "--help"], cwd=ROOT, env=environment, capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "") and done.stdout.startswith(f"usage: svrgs {command}")


def test_help_and_version(svrgs):
    assert svrgs("--help").status == svrgs("prune", "--help").status == 0
    assert re.fullmatch(r"\d+\.\d+\.\d+\n", svrgs("--version").out)
