"""Scenes larger than memory: any number of blocks and parts gives the scores and files of the whole."""

from __future__ import annotations

import contextlib
import json
import signal
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.finetune.decimate.order import order_of, visibility_sums
from svrgs_addon.finetune.quality import best_share
from svrgs_addon.finetune.refit import TrainingView, middle_scale, pace_for, refit
from svrgs_addon.finetune.viewed_scene import ViewedScene, reduced
from svrgs_addon.native.rasterizer import VISIBILITY, Rasterizer
from svrgs_addon.prune.blocks.block_rasterizer import BlockRasterizer
from svrgs_addon.prune.blocks.divided import Divided, divide, scene_of
from svrgs_addon.prune.blocks.merging import MIN_SHARE_OF_CELL, counts, merge, merged, reduce
from svrgs_addon.prune.blocks.pruning import write_joined
from svrgs_addon.prune.blocks.scoring import UNITS, picture_path, score, total, visibility
from svrgs_addon.prune.blocks.tuning import cut, mixed, tune, tuned_blocks
from svrgs_addon.prune.blocks.visible import DividedView
from svrgs_addon.prune.likeness import Likeness
from svrgs_addon.render.metrics.evaluate import render_options
from svrgs_addon.scene.gaussians import PARAMETERS
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.views.cameras_json import write_cameras_json
from svrgs_bench.scenes import orbit_camera, room

COUNT = 6_000
FEW = 240
GAINS: list[float] = []  # PSNR in dB of the tuned scene, with each number of blocks


@pytest.fixture(scope="module")
def source(tmp_path_factory) -> Path:
    path = tmp_path_factory.mktemp("large") / "room.ply"
    write_scene(path, room(COUNT, 2))
    return path


@pytest.fixture(scope="module")
def cameras():
    """Within the scene: each sees a part of it."""
    return [orbit_camera(160, 120, turn) for turn in (0.0, 0.2, 0.45, 0.7, 0.9)]


@pytest.fixture
def small_parts(monkeypatch) -> float:
    """What views blend is found out in small parts of their pictures. The largest alpha T of Gaussians that
    may be missed there: the last ones of rays that end in another part."""
    for name, value in {"PORTION": COUNT // 20, "MIN_SIDE_PIXELS": 16, "REACH": 6.0}.items():
        monkeypatch.setattr(f"svrgs_addon.prune.blocks.visible.{name}", value)
    return 1e-3


def scored(source: Path, folder: Path, most: int, parts: int, cameras) -> tuple[Divided, np.ndarray]:
    divided = divide(source, folder, most)
    for part in range(parts):
        score(divided, cameras, part, parts)
    return divided, total(divided, cameras)


@pytest.fixture(scope="module")
def whole(source, cameras, tmp_path_factory):
    return scored(source, tmp_path_factory.mktemp("whole"), COUNT, 1, cameras)


@pytest.mark.parametrize("most, parts", [(COUNT // 4, 2), (COUNT // 16, 5)])
def test_scores_do_not_depend_on_blocks_and_parts_by_a_bit(source, cameras, whole, tmp_path, most, parts):
    divided, scores = scored(source, tmp_path, most, parts, cameras)
    assert len(whole[0].blocks) == 1 and len(divided.blocks) > parts
    assert all(block.count <= most for block in divided.blocks)
    assert (scores == whole[1]).all()


def test_scores_hardly_depend_on_the_parts_of_a_picture(source, cameras, whole, tmp_path, small_parts):
    """And not at all on the number of blocks then."""
    found = [scored(source, tmp_path / str(most), most, 2, cameras)[1] for most in (COUNT, COUNT // 4)]
    assert (found[0] == found[1]).all()
    change = np.abs(visibility(found[0], 1.0) - visibility(whole[1], 1.0))[:, VISIBILITY.index("weights")]
    assert change.max() < 5 * small_parts and (change > 1e-5).mean() < 0.02


def test_scores_are_what_the_views_see_of_the_scene_in_memory(source, cameras, whole):
    expected, _ = visibility_sums(ViewedScene.of(read_scene(source), reduced(cameras)), pictures=False)
    scores = visibility(whole[1], 1.0)
    # without Gaussians that are not blended, T rounds in another way, and a ray may stop one Gaussian later
    last = {"pixels": 1, "transmittance": 2e-4}
    for column, name in enumerate(VISIBILITY):
        bound = 1e-6 * np.abs(expected[:, column]).max() + 5 * UNITS[column] + last.get(name, 0)
        assert np.abs(scores[:, column] - expected[:, column]).max() <= bound, name
    squares = VISIBILITY.index("squares")
    tiny = (expected[:, squares] > 0) & (expected[:, squares] < 1e-8)
    assert tiny.sum() > 50
    assert np.allclose(scores[tiny, squares], expected[tiny, squares], rtol=0.02, atol=1e-14)


@pytest.mark.parametrize("in_parts", [False, True])
def test_every_gaussian_that_a_view_blends_is_read(source, cameras, tmp_path, request, in_parts):
    faint = request.getfixturevalue("small_parts") if in_parts else 0.0
    divided, scene, rasterizer = divide(source, tmp_path, COUNT // 8), read_scene(source), Rasterizer()
    for camera in reduced(cameras):
        part, rows = DividedView(divided, camera, Rasterizer()).seen()
        rasterizer.forward(scene, camera, render_options(scene), outputs=())
        most = np.zeros(scene.count, np.float32)
        reached = np.zeros(scene.count, np.uint8)
        rasterizer.add_scores(max_=most, reached=reached)
        assert set(np.flatnonzero(most > faint)) <= set(rows.tolist())
        assert (np.diff(rows.astype(np.int64)) > 0).all()
        assert len(rows) < COUNT if in_parts else rows.tolist() == np.flatnonzero(reached).tolist()
        assert (part.means == scene.means[rows]).all()
        picture = rasterizer.forward(scene, camera, render_options(scene))["rgb"].copy()
        assert np.abs(rasterizer.forward(part, camera, render_options(part))["rgb"] - picture).max() < 1e-5


def test_every_gaussian_is_in_one_block_and_in_its_box(source, tmp_path):
    divided, scene = divide(source, tmp_path, 700), read_scene(source)
    rows = np.concatenate([block.rows for block in divided.blocks])
    assert sorted(rows.tolist()) == list(range(COUNT))
    for block in divided.blocks:
        assert (block.geometry[:, :3] == scene.means[block.rows]).all()
        assert (block.sh(9) == scene.sh[block.rows]).all()
        assert (block.geometry[:, :3] >= block.low).all() and (block.geometry[:, :3] <= block.high).all()
        assert block.largest == scene.log_scales[block.rows].max()
    again = Divided.read(tmp_path)
    assert again.count == COUNT and again.digest == divided.digest
    assert [one.count for one in again.blocks] == [one.count for one in divided.blocks]


@pytest.fixture(scope="module", params=[COUNT, COUNT // 4])
def ordered(request, source, cameras, tmp_path_factory) -> Divided:
    divided, _ = scored(source, tmp_path_factory.mktemp("ordered"), request.param, 2, cameras)
    reduce(divided, cameras)
    for block in divided.blocks:
        merge(divided, block.number)
    return divided


def test_so_many_are_left_as_are_wanted_at_one_cost_for_all_blocks(ordered):
    for wanted in (COUNT, COUNT - 1, 4_321, COUNT // 10):
        cells = counts(ordered, wanted)
        kept = [sum(some) for some in cells]
        assert sum(kept) == wanted
        assert all(0 < count <= block.count for count, block in zip(kept, ordered.blocks, strict=True))
        parts = list(merged(ordered, cells))
        assert [part.count for part in parts] == kept and all(np.isfinite(part.means).all() for part in parts)
    shares = [
        sum(some) / block.count
        for some, block in zip(counts(ordered, COUNT // 4), ordered.blocks, strict=True)
    ]
    assert len(shares) == 1 or max(shares) > 1.3 * min(shares), "what is seen more keeps more"
    assert sum(map(sum, counts(ordered, 1))) == sum(
        max(1, round(MIN_SHARE_OF_CELL * block.count)) for block in ordered.blocks
    )


def test_the_same_gaussians_are_merged_whatever_the_number_of_blocks(source, cameras, tmp_path, monkeypatch):
    monkeypatch.setattr("svrgs_addon.prune.blocks.merging.CELL", COUNT // 16)
    files = []
    for most in (COUNT, COUNT // 4, COUNT // 16):
        divided, _ = scored(source, tmp_path / str(most), most, 1, cameras)
        reduce(divided, cameras)
        for block in divided.blocks:
            merge(divided, block.number)
        cells = counts(divided, COUNT // 4)
        assert sum(map(len, cells)) == 16 and len(divided.blocks) == COUNT // most
        write_joined(cut(divided, cameras, COUNT // 4), tmp_path / f"{most}.ply")
        files.append((tmp_path / f"{most}.ply").read_bytes())
    # what is seen more keeps more, cell by cell too
    assert len(set(files)) == 1 and np.ptp(sum(cells, [])) > 100


def test_orders_of_other_cells_are_refused(source, cameras, tmp_path, monkeypatch):
    divided, _ = scored(source, tmp_path, COUNT, 1, cameras)
    reduce(divided, cameras)
    merge(divided, 0)
    monkeypatch.setattr("svrgs_addon.prune.blocks.merging.CELL", COUNT // 2)
    with pytest.raises(FormatError, match="merge it again"):
        counts(divided, COUNT // 2)


def test_blocks_and_formats_change_the_result_little(ordered, source, cameras, tmp_path):
    likeness, left = Likeness(ordered, cameras, BlockRasterizer), cut(ordered, cameras, COUNT // 4)

    def psnr_of(name: str) -> float:
        write_joined(left, tmp_path / name)
        assert read_scene(tmp_path / name).count == left.count == COUNT // 4
        return likeness.psnr(divide(tmp_path / name, tmp_path / f"{name}.blocks"))

    scene = read_scene(source)
    sums, _ = visibility_sums(ViewedScene.of(scene, reduced(cameras)), pictures=False)
    write_scene(tmp_path / "memory.ply", order_of(scene, sums, COUNT // 4).at(COUNT // 4))
    undivided = likeness.psnr(divide(tmp_path / "memory.ply", tmp_path / "memory"))
    exact, packed = psnr_of("a.ply"), psnr_of("a.spz")
    assert undivided > 50 and abs(exact - undivided) < (0.2 if len(ordered.blocks) == 1 else 1)
    assert 40 < packed < exact
    assert likeness.psnr(ordered) == 100 and abs(likeness.psnr(left) - exact) < 0.01


def test_one_block_is_tuned_as_the_scene_in_memory(ordered, source, cameras):
    if len(ordered.blocks) > 1:
        pytest.skip("of one block")
    left, views = cut(ordered, cameras, COUNT // 4), reduced(cameras)
    tune(ordered, 0, cameras, 9)
    scene, original = scene_of(left, left.blocks[0]), read_scene(source)
    pictures = [np.load(picture_path(ordered, k)).astype(np.float32) for k in range(len(views))]
    for view, picture in zip(views, pictures, strict=True):
        assert (
            np.abs(Rasterizer().forward(original, view, render_options(original))["rgb"] - picture).max()
            < 2**-11
        )
    error = json.loads((left.folder / "error.json").read_text())["error"]
    shown = [Rasterizer().forward(scene, view, render_options(scene))["rgb"] for view in views]
    assert error == pytest.approx(
        np.mean([np.square(one - other).mean() for one, other in zip(shown, pictures, strict=True)]) ** 0.5,
        rel=1e-3,
    )
    assert error < 0.01
    expected = refit(
        scene,
        list(map(TrainingView, views, pictures)),
        9,
        pace_for(error),
        middle_scale(scene.log_scales),
        render_options(scene),
        0,
        lambda: False,
    )
    found = tuned_blocks(ordered)
    tuned = scene_of(found, found.blocks[0])
    for name in PARAMETERS:
        change = np.abs(getattr(expected, name) - getattr(scene, name)).max()
        assert change > 0 and np.abs(getattr(tuned, name) - getattr(expected, name)).max() < 0.02 * change, (
            name
        )


def test_tuned_blocks_are_as_good_as_the_tuned_whole_in_any_order(ordered, cameras):
    likeness, left = Likeness(ordered, cameras, BlockRasterizer), cut(ordered, cameras, FEW)
    with (
        pytest.raises(SceneError, match="the block 0 is missing; do the step before it first")
        if len(left.blocks) > 1
        else contextlib.nullcontext()
    ):
        tune(ordered, len(left.blocks) - 1, cameras, 60)
        tuned_blocks(ordered)
    for number in reversed(range(len(left.blocks) - 1)):
        tune(ordered, number, cameras, 60)
    tuned = tuned_blocks(ordered)
    assert [one.count for one in tuned.blocks] == [one.count for one in left.blocks] and tuned.count == FEW
    before, after = (likeness.psnr(one) for one in (left, tuned))
    assert after > before + 5
    first = (tuned.folder / "0.geometry").read_bytes()
    tune(ordered, 0, cameras, 60)
    # neither order nor what was tuned before counts
    assert (tuned.folder / "0.geometry").read_bytes() == first
    GAINS.append(after)
    assert max(GAINS) - min(GAINS) < 1, "of a scene of a few Gaussians; docs/farm.md has those of large ones"


def test_where_fine_tuning_does_harm_less_of_it_is_taken(ordered, cameras):
    left = cut(ordered, cameras, FEW)
    for number in range(len(left.blocks)):
        tune(ordered, number, cameras, 3)
    tuned, asked = tuned_blocks(ordered), []

    def likes(share: float):
        def quality(part: float) -> float:
            pairs = zip(mixed(ordered, tuned, part).blocks, left.blocks, strict=True)
            change = max(np.abs(one.geometry[:, :3] - other.geometry[:, :3]).max() for one, other in pairs)
            asked.append(change)
            return -abs(change - share * asked[0])

        return quality

    assert best_share(likes(0.5)) == 0.5 and len(asked) == 4
    assert mixed(ordered, tuned, 0.0).folder == left.folder and mixed(ordered, tuned, 1.0) is tuned
    asked.clear()
    assert best_share(likes(1.0)) == 1.0 and len(asked) == 2
    asked.clear()
    assert best_share(likes(0.0)) == 0.0 and len(asked) == 5


def test_pictures_that_are_missing_are_named(source, cameras, tmp_path):
    divided, _ = scored(source, tmp_path, COUNT, 1, cameras)
    reduce(divided, cameras)
    merge(divided, 0)
    cut(divided, cameras, COUNT // 2)
    assert tuned_blocks(divided) is None
    path = tmp_path / "3.picture.npy"
    for contents, sentence in (
        (path.read_bytes()[:500], "score the views first"),
        ((tmp_path / "scores_0_of_1").name.encode(), "score the views first"),
    ):
        path.write_bytes(contents)
        with pytest.raises(FormatError, match=sentence):
            tune(divided, 0, cameras, 5)
    np.save(path, np.zeros((3, 4, 3), np.float16))
    with pytest.raises(FormatError, match="is not of this view"):
        tune(divided, 0, cameras, 5)


def test_steps_that_are_missing_are_named(source, cameras, tmp_path):
    divided, _ = scored(source, tmp_path, COUNT // 2, 1, cameras)
    with pytest.raises(SceneError, match="merge the block 0 first"):
        counts(divided, 100)
    with pytest.raises(SceneError, match="reduce the scores first"):
        merge(divided, 0)
    reduce(divided, cameras)
    with pytest.raises(SceneError, match="only 0 to 1"):
        merge(divided, 2)
    for number in (0, 1):
        merge(divided, number)
    path = tmp_path / "1.order.npz"
    path.write_bytes(path.read_bytes()[:300])
    with pytest.raises(FormatError, match="merge the block again"):
        counts(divided, 100)


def test_columns_that_are_lost_are_named(tmp_path, caplog):
    columns = dict(
        label=np.zeros(20, np.uint8), nx=np.zeros(20, np.float32), svrgs_row=np.arange(20, dtype=np.int32)
    )
    write_scene(tmp_path / "a.ply", replace(room(20, 0), attributes=columns))
    divide(tmp_path / "a.ply", tmp_path / "b")
    assert "left out: label" in caplog.text and "svrgs_row" not in caplog.text


def test_points_in_one_place_are_divided_too(tmp_path):
    scene = room(100, 0)
    scene.means[:] = 1.0
    write_scene(tmp_path / "a.ply", scene)
    assert [block.count for block in divide(tmp_path / "a.ply", tmp_path / "b", 30).blocks] == [
        25,
        25,
        25,
        25,
    ]


def test_missing_and_foreign_parts_are_not_added(source, cameras, tmp_path):
    divided = divide(source, tmp_path, COUNT)
    with pytest.raises(SceneError, match="missing"):
        total(divided, cameras)
    score(divided, cameras, 0, 2)
    with pytest.raises(SceneError, match="1 of 2"):
        total(divided, cameras)
    score(divided, cameras[:4], 1, 2)  # of other cameras
    with pytest.raises(SceneError, match="1 of 2"):
        total(divided, cameras)
    path = score(divided, cameras, 1, 2)
    assert total(divided, cameras).shape == (COUNT, 10)
    path.write_bytes(path.read_bytes()[:1000])
    with pytest.raises(FormatError, match="again"):
        total(divided, cameras)


def test_the_folder_of_blocks_is_not_one_with_other_files(source, cameras, tmp_path, svrgs):
    write_cameras_json(
        tmp_path / "views.json", [replace(camera, name=str(k)) for k, camera in enumerate(cameras)]
    )
    words = ["large", "prune", source, "--cameras", tmp_path / "views.json", "--force", "--target", 0.5]
    words += ["--out", tmp_path / "out.ply", "--json"]
    (tmp_path / "out.ply.blocks").mkdir()
    (tmp_path / "out.ply.blocks/mine.txt").write_text("mine")
    refused = svrgs(*words)
    assert refused.status == 2 and "holds no blocks" in refused.err and not (tmp_path / "out.ply").exists()
    (tmp_path / "out.ply.blocks/scored_views.json").write_text("[]")  # as if a run had been killed
    (tmp_path / "out.ply.blocks/0001.png").write_text("mine")
    assert svrgs(*words).json["after"]["count"] == COUNT // 2
    assert {path.name for path in (tmp_path / "out.ply.blocks").iterdir()} == {"mine.txt", "0001.png"}


def test_a_divided_scene_that_is_damaged_is_one_sentence(source, cameras, tmp_path):
    divided = divide(source, tmp_path, COUNT // 2)
    (tmp_path / "1.geometry").write_bytes(b"short")
    with pytest.raises(FormatError, match=r"1\.geometry: cannot be read"):
        DividedView(Divided.read(tmp_path), cameras[0], Rasterizer()).seen()
    contents = json.loads((tmp_path / "blocks.json").read_text())
    for change in ({"schema": 9}, {"blocks": 3}, {"count": "many"}):
        (tmp_path / "blocks.json").write_text(json.dumps(contents | change))
        with pytest.raises(FormatError, match="divide the scene again"):
            Divided.read(tmp_path)
    (tmp_path / "blocks.json").unlink()
    with pytest.raises(SceneError, match="divide the scene first"):
        Divided.read(tmp_path)
    assert divided.count == COUNT


@pytest.mark.slow
@pytest.mark.skipif(sys.platform == "win32", reason="signal 9")
def test_steps_that_are_killed_and_done_again_give_the_same_bytes(source, cameras, tmp_path, svrgs):
    write_cameras_json(
        tmp_path / "views.json", [replace(camera, name=str(k)) for k, camera in enumerate(cameras)]
    )
    work, given = tmp_path / "work", ["--cameras", tmp_path / "views.json", "--block", "2000", "--force"]
    assert (
        svrgs(f"large prune {source}", *given, f"--target 0.05 --steps 40 --out {tmp_path}/one.ply").status
        == 0
    )
    killed = 0
    for step, *more in (
        ("divide", source, *given, "--work", work),
        ("score",),
        ("reduce",),
        ("merge",),
        ("cut", "--target", "0.05"),
        ("tune", "--steps", "40"),
    ):
        command = ["large", step, *more] if step == "divide" else ["large", step, work, *more]
        words = [sys.executable, "-m", "svrgs_addon", *map(str, command)]
        process = subprocess.Popen(
            words, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, cwd=Path(__file__).resolve().parents[1]
        )
        assert process.stderr is not None
        process.stderr.readline()  # the first line of its progress, if it tells any
        process.kill()
        killed += process.wait() == -signal.SIGKILL
        process.stderr.close()
        assert svrgs(*command).status == 0
    assert killed >= 3, "most were still at work"
    assert svrgs("large", "finish", work, "--out", tmp_path / "many.ply").status == 0
    assert (tmp_path / "many.ply").read_bytes() == (tmp_path / "one.ply").read_bytes()
    assert svrgs("large", "tune", work, "--steps", "0").status == 0
    untuned = svrgs("large", "finish", work, "--out", tmp_path / "many.ply", "--json").json
    # what was tuned before does not count
    assert untuned["tuned_share"] == 0 and untuned["psnr_merged"] is None


@pytest.mark.slow
def test_a_block_that_no_view_sees_stays_as_it_was_cut(source, tmp_path):
    wide = orbit_camera(160, 120, 0.1)
    K = wide.K.copy()
    K[:2, :2] *= 6
    narrow = [replace(wide, K=K)]
    divided, _ = scored(source, tmp_path, 300, 1, narrow)
    reduce(divided, narrow)
    for block in divided.blocks:
        merge(divided, block.number)
    left = cut(divided, narrow, 1500)
    for block in left.blocks:
        tune(divided, block.number, narrow, 4)
    changed = [
        (one.geometry != other.geometry).any()
        for one, other in zip(left.blocks, tuned_blocks(divided).blocks, strict=True)
    ]
    assert 0 < sum(changed) < len(changed) / 2
