"""Commands refuse what does not fit with one sentence and exit 2, and write nothing."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import tiny_dataset
from command_checks import files, refused
from svrgs_addon.files.ply import read_ply, write_ply
from svrgs_addon.native.rasterizer import Rasterizer
from svrgs_addon.prune.recipes import fine_tuned


@pytest.fixture
def work(tiny, tmp_path) -> Path:
    """A private copy of the tiny dataset, to be broken, with an ordinary file 'file' beside."""
    shutil.copytree(tiny.folder, tmp_path / "data")
    (tmp_path / "file").write_text("no folder")
    return tmp_path


def no_photographs(work: Path):
    for i in range(9):
        (work / f"data/images/{i:02}.png").unlink()


def no_image_folder(work: Path):
    shutil.rmtree(work / "data/images")


def no_model(work: Path):
    shutil.rmtree(work / "data/sparse")


def no_views(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(1), np.zeros((0, 3)))
    path = work / "data/sparse/0/images.bin"
    path.write_bytes(bytes(8))


def panorama(work: Path):
    tiny_dataset.write_colmap(
        work / "data/sparse/0", tiny_dataset.views(), np.zeros((9, 3)), "EQUIRECTANGULAR"
    )


def one_view(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(1), np.zeros((9, 3)))


def no_points(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(), np.zeros((0, 3)))


def points_behind_the_cameras(work: Path):
    tiny_dataset.write_colmap(work / "data/sparse/0", tiny_dataset.views(), np.full((9, 3), 1e4))


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
    cameras = [
        replace(camera, name=name)
        for camera, name in zip(tiny_dataset.views(2), ("a.png", "a.jpg"), strict=True)
    ]
    for number, camera in enumerate(cameras):
        shutil.copy(work / f"data/images/{number:02}.png", work / "data/images" / camera.name)
    tiny_dataset.write_colmap(work / "data/sparse/0", cameras, np.zeros((0, 3)))


def link_loop(work: Path):
    (work / "data/loop").symlink_to("pool")
    (work / "data/pool").symlink_to("loop")


def far_view(work: Path):
    first, *rest = tiny_dataset.views()
    viewmat = first.viewmat.copy()
    viewmat[0, 3] = 1e38
    tiny_dataset.write_colmap(
        work / "data/sparse/0", [replace(first, viewmat=viewmat), *rest], np.zeros((9, 3))
    )


def huge_focal_length(work: Path):
    views = [replace(view, K=view.K * 1e30) for view in tiny_dataset.views()]
    tiny_dataset.write_colmap(work / "data/sparse/0", views, np.zeros((9, 3)))


def nothing(work: Path):
    pass


DATA = "--data {data}"
PRUNE = f"prune {{data}}/scene.ply {DATA} --quiet --out {{work}}/o.ply --report {{work}}/report"
TRAIN = f"train {DATA} --iterations 5 --quiet --out {{work}}/o.ply"
INFO = "info {data}/scene.ply"
EVAL = f"eval {{data}}/scene.ply {DATA}"
RENDER = f"render {{data}}/scene.ply {DATA} --out {{work}}/out"
COMPARE = f"compare {{data}}/scene.ply {{data}}/scene.ply {DATA} --out {{work}}/out"

REFUSED = [  # what is broken, the command, what the sentence says
    *(
        (no_photographs, command, ("9 of 12 photographs are missing: 00.png, 01.png, 02.png, ...",))
        for command in (PRUNE, TRAIN, EVAL, COMPARE)
    ),
    *((no_image_folder, command, ("no image folder",)) for command in (PRUNE, EVAL)),
    *((no_model, command, ("holds no COLMAP model",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *((no_views, command, ("no view with a pose",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *((panorama, command, ("EQUIRECTANGULAR",)) for command in (PRUNE, TRAIN, EVAL, RENDER, COMPARE)),
    *(
        (truncated_splat, command, ("scene.ply is incomplete: ", " kB; copy or export it again"))
        for command in ("info {data}/scene.ply", PRUNE, EVAL, RENDER, COMPARE)
    ),
    *(
        (splat_elsewhere, command, ("scene.ply", "none of its Gaussians is near"))
        for command in (PRUNE, EVAL, COMPARE)
    ),
    *(
        (empty_splat, command, ("scene.ply", "no usable Gaussian"))
        for command in (PRUNE, EVAL, RENDER, COMPARE)
    ),
    *((broken_photograph, command, ("00.png", "cannot be read as an image")) for command in (PRUNE, EVAL)),
    (one_view, PRUNE, ("--holdout 0",)),
    (one_view, TRAIN, ("--holdout 0",)),
    (one_view, f"{EVAL} --split train", ("no train views",)),
    (one_view, f"{RENDER} --views train", ("no train views",)),
    (no_points, TRAIN, ("no 3-D points",)),
    (points_behind_the_cameras, TRAIN, ("no training view sees any of the 9 sparse points", "0.2")),
    *(
        (damage, command, ("00.png", "focal length or pose that is not usable"))
        for damage in (far_view, huge_focal_length)
        for command in (TRAIN, EVAL, RENDER)
    ),
    *(
        (same_stems, command, ("'a.jpg' and 'a.png'", "same files"))
        for command in (RENDER, f"{COMPARE} --holdout 1")
    ),
    *(
        (nothing, f"{command} --lpips-weights {{work}}/no.npz", ("--lpips-weights", "no.npz"))
        for command in (PRUNE, TRAIN, EVAL, COMPARE)
    ),
    (nothing, f"{PRUNE} --method dropout", ("method 'dropout' is unknown", "svr, ")),
    (nothing, f"{TRAIN} --method dropout", ("method 'dropout' is unknown",)),
    (nothing, f"{TRAIN} --method opacity", ("needs --target",)),
    *(
        (nothing, f"{PRUNE} --lambda-f={value}", ("--lambda-f", f"'{value}' is not a weight"))
        for value in ("-1", "nan", "inf", "much")
    ),
    (nothing, f"{PRUNE} --method maskgs --lambda-f 1e-4", ("method 'maskgs' has no spatial mask",)),
    *(
        (nothing, f"{PRUNE} --target {value}", ("--target", f"'{value}' is not a share"))
        for value in ("0", "1.5", "half")
    ),
    (nothing, f"{PRUNE} --target 0.5 --target-count 9", ("not allowed with",)),
    (nothing, f"{PRUNE} --target-count 0", ("--target-count",)),
    (nothing, f"{PRUNE} --method opacity", ("needs --target",)),
    (nothing, f"{PRUNE} --method 3dgs --target 0.5", ("cannot reach a target",)),
    (nothing, f"{PRUNE} --iterations 0 --target 0.5", ("cannot reach a target",)),
    *(
        (nothing, f"{PRUNE} --min-contribution {value}", ("--min-contribution",))
        for value in ("1", "-1", "nan")
    ),
    (nothing, f"{PRUNE} --min-contribution 0.9999", ("pruning would leave 0 of", "min-contribution")),
    (nothing, f"{PRUNE} --iterations -3", ("--iterations",)),
    (nothing, f"{PRUNE} --engine cuda", ("--engine",)),
    (nothing, f"{RENDER} --views 00,99", ("there is no view '99'", "0 to 11")),
    (nothing, f"{RENDER} --views \N{SUPERSCRIPT TWO}", ("there is no view",)),
    (nothing, f"{RENDER} --views {'9' * 5000}", ("there is no view '9999999", "...'")),
    (nothing, f"{EVAL} --holdout {'9' * 5000}", ("--holdout", "999...' is not a whole number")),
    (nothing, f"{PRUNE} --image-memory 1e300", ("--image-memory", "0 to 1,000,000")),
    (nothing, f"{PRUNE} --lambda-m 1e300", ("--lambda-m", "0 to 1e9")),
    (nothing, f"{EVAL} --image-memory 1", ("--image-memory",)),
    (
        link_loop,
        f"prune {{data}}/scene.ply {DATA} --out {{data}}/loop",
        ("loop", "Too many levels of symbolic links"),
    ),
    (link_loop, "prune {data} --out {data}/loop", ("loop", "Too many levels of symbolic links")),
    (nothing, f"{RENDER} --outputs rgb,normals", ("output 'normals' is unknown",)),
    (nothing, f"{RENDER} --format gif", ("--format",)),
    (nothing, f"{RENDER} --background 0,0,2", ("--background",)),
    (nothing, "render {data}/scene.ply --out {work}/out", ("--data", "--cameras")),
    (nothing, "render {data}/scene.ply --cameras {work}/file --out {work}/out", ("is not JSON",)),
    (
        nothing,
        "render {data}/scene.ply --cameras {work}/none.json --out {work}/out",
        ("none.json", "cannot be read"),
    ),
    (nothing, f"prune {{data}}/scene.ply {DATA} --out {{data}}/scene.ply", ("is the input itself",)),
    (nothing, f"prune {{work}}/file --out {{work}}/o.ply {DATA}", ("are not read",)),
    (nothing, f"prune {{work}}/none.ply --out {{work}}/o.ply {DATA}", ("there is no such file",)),
    (nothing, f"prune {{data}}/sparse --out {{work}}/o.ply {DATA}", ("holds no splat",)),
    (nothing, "info {work}/none.ply", ("there is no such file",)),
    (nothing, "info {work}", ("is a folder",)),
    (nothing, "paint", ("invalid choice",)),
    (nothing, "", ("COMMAND",)),
]


@pytest.mark.parametrize(
    "damage, line, words", REFUSED, ids=lambda value: value.__name__ if callable(value) else None
)
def test_bad_input_is_refused_and_nothing_written(work, svrgs, damage, line, words):
    damage(work)
    before = files(work)
    refused(svrgs(*line.format(work=work, data=work / "data").split()), *words)
    assert files(work) == before and sorted(path.name for path in work.iterdir()) == ["data", "file"]


UNWRITABLE = {
    "prune": "prune {scene} --data {data} --out {file}/o.ply",
    "prune, report": "prune {scene} --data {data} --out {work}/o.ply --report {file}",
    "prune, checkpoints": "prune {scene} --data {data} --out {work}/busy.ply",  # busy.ply.job is a file
    "prune, other suffix": "prune {scene} --data {data} --out {work}/o.obj",
    "train": "train --data {data} --out {file}/o.ply",
    "train, folder": "train --data {data} --out {work}",
    "render": "render {scene} --data {data} --out {file}",
    "compare": "compare {scene} {scene} --data {data} --out {file}/deeper",
}


@pytest.mark.parametrize("line", UNWRITABLE.values(), ids=UNWRITABLE)
def test_an_output_that_cannot_be_written_is_found_before_the_work(tiny, svrgs, tmp_path, monkeypatch, line):
    for module, name in ((fine_tuned, "load_scene"), (fine_tuned.FineTuned, "tune"), (Rasterizer, "forward")):
        monkeypatch.setattr(module, name, lambda *_, **__: pytest.fail("the work has begun"))
    (tmp_path / "file").write_text("no folder")
    (tmp_path / "busy.ply.job").write_text("no folder")
    before = files(tmp_path)
    words = line.format(scene=tiny.splat, data=tiny.folder, work=tmp_path, file=tmp_path / "file").split()
    refused(svrgs(*words), str(tmp_path))
    assert files(tmp_path) == before


def test_options_of_photographs_are_refused_without_them(tiny, svrgs, tmp_path):
    scene = shutil.copy(tiny.splat, tmp_path / "alone.ply")
    refused(svrgs("prune", scene, "--images", "images_4"), "--images", "--data")
    refused(svrgs("prune", scene, "--seen-from-only"), "--seen-from-only", "with --seen-from")
    assert list(files(tmp_path)) == ["alone.ply"]
