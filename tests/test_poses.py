"""Poses that are slightly off: cameras are displaced, views aligned, and poses refined while a splat is
trained."""

from __future__ import annotations

import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from colmap_model import write_colmap
from plans import prune_settings
from short_runs import whole_and_taken_up
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.finetune.engine import NativeEngine, Step
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.poses import Poses
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Rates
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.prune.context import JobContext
from svrgs_addon.prune.photographs import in_its_colours, prepared
from svrgs_addon.render import pose_alignment
from svrgs_addon.render.pose_alignment import aligned
from svrgs_addon.scene.camera import Camera
from svrgs_addon.views.cameras_json import load_cameras_json
from svrgs_addon.views.dataset import load_dataset

STEPS = ("--iterations", 60, "--recovery", 60, "--target", 0.5)
TRAINED = [number for number in range(12) if number % 8]


def motion(rng: np.random.Generator, degrees: float, length: float) -> np.ndarray:
    """A motion (Camera.displaced) in a random direction."""
    turn, move = rng.normal(size=(2, 3))
    scales = np.radians(degrees) / np.linalg.norm(turn), length / np.linalg.norm(move)
    return np.concatenate([turn * scales[0], move * scales[1]])


@pytest.fixture
def shaken(tiny, tmp_path) -> Path:
    """The tiny dataset, whose training cameras are off."""
    rng, folder = np.random.default_rng(0), tmp_path / "shaken"
    shutil.copytree(tiny.folder / "images", folder / "images")
    cameras = [
        camera.displaced(motion(rng, 1.0, 0.02)) if number in TRAINED else camera
        for number, camera in enumerate(tiny.cameras)
    ]
    write_colmap(folder / "sparse" / "0", cameras, tiny.truth.means)
    return folder


@pytest.fixture
def splat(tiny, tmp_path) -> Path:
    """A splat that shows the photographs well."""
    write_scene(tmp_path / "splat.ply", tiny.truth)
    return tmp_path / "splat.ply"


def beside(camera: Camera, other: Camera, points: np.ndarray) -> float:
    """By how many pixels points (n, 3), world, are elsewhere in the other view, the mean."""
    local = lambda view: points @ view.viewmat[:3, :3].T + view.viewmat[:3, 3]
    offsets = camera.pixels(local(camera)) - other.pixels(local(other))
    return float(np.linalg.norm(offsets, axis=1).mean())


def mean_beside(cameras: list[Camera], tiny) -> float:
    by_name = {camera.name: camera for camera in cameras}
    truth = [tiny.cameras[number] for number in TRAINED]
    return float(np.mean([beside(one, by_name[one.name], tiny.truth.means) for one in truth]))


# --- cameras


def test_a_displaced_camera_turns_about_its_centre_and_moves(tiny):
    camera, angle = tiny.cameras[3], 0.3
    moved = camera.displaced(np.array([0, angle, 0, 0.1, 0.2, 0.3]))
    R = camera.viewmat[:3, :3]
    np.testing.assert_allclose(R @ (moved.position - camera.position), [0.1, 0.2, 0.3], atol=1e-14)
    np.testing.assert_allclose(moved.viewmat[:3, :3] @ moved.viewmat[:3, :3].T, np.eye(3), atol=1e-14)
    np.testing.assert_allclose(moved.viewmat[1, :3], R[1], atol=1e-14)
    assert moved.viewmat[2, :3] @ camera.viewmat[2, :3] == pytest.approx(np.cos(angle))
    # right-handed: about the axis that points down in the image, the view turns to the right
    assert moved.viewmat[2, :3] @ camera.viewmat[0, :3] == pytest.approx(np.sin(angle))
    still = camera.displaced(np.zeros(6))
    np.testing.assert_allclose(still.viewmat, camera.viewmat, atol=1e-15)


@pytest.mark.parametrize("dtype", ["float32", "float64"])
def test_both_engines_give_the_same_gradient(tiny, dtype):
    torch_engine = pytest.importorskip("svrgs_addon.finetune.torch_engine")
    level = "float64" if dtype == "float64" else None
    camera, model = tiny.cameras[1], Model.of(tiny.truth, np.dtype(dtype))
    target = np.random.default_rng(0).random((camera.height, camera.width, 3)).astype(dtype)
    step = Step(camera, target, 1, Rates().at(1, 1.0), RenderOptions(), update=False, want_camera=True)
    engines = NativeEngine(level), torch_engine.TorchEngine(level)
    native, other = (engine.step(model, step).camera for engine in engines)
    np.testing.assert_allclose(native, other, rtol=1e-4 if dtype == "float32" else 1e-9)


# --- alignment


@pytest.mark.parametrize("gain", [1.0, 0.7])
def test_a_view_is_aligned_with_its_photograph_whatever_its_exposure(tiny, gain):
    r, rng, options = Rasterizer(), np.random.default_rng(1), RenderOptions(picture_only=True)
    for camera in tiny.cameras[:4]:
        photo = r.forward(tiny.truth, camera)["rgb"] * np.float32(gain)
        off = camera.displaced(motion(rng, 1.0, 0.02))
        found = aligned(tiny.truth, off, photo, r, options)
        assert beside(camera, off, tiny.truth.means) > 0.3
        assert beside(camera, found.camera(), tiny.truth.means) < 0.02


def test_what_a_mask_hides_moves_no_view(tiny):
    r, options, camera = Rasterizer(), RenderOptions(picture_only=True), tiny.cameras[0]
    valid = np.ones((camera.height, camera.width), np.uint8)
    valid[:, :24] = 0
    masked = camera.displaced(motion(np.random.default_rng(2), 1.0, 0.02)).masked(valid)
    photo, found = r.forward(tiny.truth, camera)["rgb"], []
    for value in (0.0, 1.0):
        seen = np.where(valid[..., None], photo, np.float32(0))
        hidden = tiny.truth.means if value else tiny.truth.means.copy()
        found.append(aligned(replace(tiny.truth, means=hidden), masked, seen, r, options).camera().viewmat)
    np.testing.assert_array_equal(*found)
    assert beside(camera, replace(camera, viewmat=found[0]), tiny.truth.means) < 0.1


def test_masked_pixels_do_not_count_as_brightness(tiny):
    r, options, camera = Rasterizer(), RenderOptions(picture_only=True), tiny.cameras[0]
    valid = np.ones((camera.height, camera.width), np.uint8)
    valid[:, :26] = 0
    photo = np.float32(0.6) * r.forward(tiny.truth, camera)["rgb"] + np.float32(0.3)
    found = aligned(tiny.truth, camera.masked(valid), photo, r, options)
    assert beside(camera, found.camera(), tiny.truth.means) < 0.05


@pytest.mark.parametrize("size", [(2400, 8), (8, 2400), (3, 2)])
def test_pictures_of_any_shape_are_compared(tiny, size):
    camera = tiny.cameras[0].resized(*size)
    data = replace(load_dataset(tiny.folder), cameras=[camera], train_indices=[0], test_indices=[], photos=[])
    photo = Rasterizer().forward(tiny.truth, camera)["rgb"].clip(0, 1)
    data._cache[0] = photo
    plan = replace(prune_settings("removal", 2, 2, target=100), exposure="auto", refine_poses="auto")
    found = prepared(
        tiny.truth, in_its_colours(tiny.truth, data, plan).dataset, plan, JobContext(Path("o.ply"))
    )
    assert (found.plan.exposure, found.plan.refine_poses, found.notes) == ("off", "off", [])


def test_a_view_that_shows_nothing_stays(tiny):
    camera = tiny.cameras[0]
    away = replace(camera, viewmat=np.diag([-1.0, 1, -1, 1]) @ camera.viewmat)
    black = np.zeros((camera.height, camera.width, 3), np.float32)
    found = aligned(tiny.truth, away, black, Rasterizer(), RenderOptions(picture_only=True))
    assert not found.motion.any()
    np.testing.assert_array_equal(found.camera().viewmat, away.viewmat)


# --- whole jobs


def pruned(svrgs, splat: Path, data: Path, out: Path, *words: object) -> dict:
    return svrgs("prune", splat, "--data", data, *STEPS, "--out", out, *words, "--json").json


def note_of(found: dict) -> str:
    (note,) = [note for note in found["notes"] if note.startswith("the photographs lie ")]
    return note


def test_poses_that_are_off_are_found_and_refined(tiny, splat, shaken, tmp_path, svrgs):
    plain = pruned(svrgs, splat, shaken, tmp_path / "plain.ply", "--refine-poses", "off")
    found = pruned(svrgs, splat, shaken, tmp_path / "o.ply")
    assert note_of(plain).endswith("--refine-poses on moves the cameras")
    assert note_of(found).endswith("so poses are refined")
    assert found["psnr"] > plain["psnr"] + 1 and found["psnr_aligned"] > plain["psnr"] + 1
    assert plain["poses"] is None and found["poses"]["file"] == str(tmp_path / "o.ply_refined_cameras.json")
    written = load_cameras_json(tmp_path / "o.ply_refined_cameras.json")
    assert [camera.name for camera in written] == [f"{number:02}.png" for number in TRAINED]
    assert mean_beside(load_dataset(shaken).cameras, tiny) > 3 * mean_beside(written, tiny)


def test_right_poses_are_kept_and_change_no_bit(tiny, splat, tmp_path, svrgs):
    found = [
        pruned(svrgs, splat, tiny.folder, tmp_path / f"{way}.ply", "--refine-poses", way)
        for way in ("off", "auto")
    ]
    assert (tmp_path / "off.ply").read_bytes() == (tmp_path / "auto.ply").read_bytes()
    for one in found:
        assert one["notes"] == [] and one["compared"]["aligned_db"] < 0.2 and "psnr_aligned" not in one
    assert not [*tmp_path.glob("*_refined_cameras.json")]


def test_poses_of_an_earlier_result_go(splat, shaken, tmp_path, svrgs):
    pruned(svrgs, splat, shaken, tmp_path / "o.ply", "--refine-poses", "on")
    assert (tmp_path / "o.ply_refined_cameras.json").exists()
    pruned(svrgs, splat, shaken, tmp_path / "o.ply", "--refine-poses", "off", "--overwrite")
    assert not (tmp_path / "o.ply_refined_cameras.json").exists()


def test_eval_measures_after_alignment_if_asked(splat, shaken, svrgs):
    words = ["eval", splat, "--data", shaken, "--split", "train"]
    plain, moved = svrgs(*words, "--json").json, svrgs(*words, "--aligned", "--json").json
    assert moved["psnr_aligned"] > plain["psnr"] + 2 and moved["psnr"] == plain["psnr"]
    assert "psnr_aligned" not in plain and "PSNR after alignment" in svrgs(*words, "--aligned").out


def test_training_refines_poses_if_it_is_told_to(tiny, shaken, tmp_path, svrgs):
    words = ["train", "--data", shaken, "--iterations", 200]
    for way in ("auto", "on"):
        svrgs(*words, "--refine-poses", way, "--out", tmp_path / f"{way}.ply", "--json")
    assert [path.name for path in tmp_path.glob("*_refined_cameras.json")] == ["on.ply_refined_cameras.json"]
    before = mean_beside(load_dataset(shaken).cameras, tiny)
    assert mean_beside(load_cameras_json(tmp_path / "on.ply_refined_cameras.json"), tiny) < before


def test_a_run_that_is_taken_up_again_gives_the_same_poses(splat, shaken, tmp_path):
    plan = replace(prune_settings("removal", 12, 8, target=100), refine_poses="on")

    def run() -> Run:
        return Run(Model.of(read_scene(splat)), load_dataset(shaken), plan, NativeEngine())

    whole, second = whole_and_taken_up(run, tmp_path / "kept")
    np.testing.assert_array_equal(whole.poses.viewmats, second.poses.viewmats)
    np.testing.assert_array_equal(whole.model.values["sh"], second.model.values["sh"])
    assert whole.dataset.cameras[1].viewmat.tolist() == whole.poses.viewmats[0].tolist()


def test_a_gradient_that_is_not_finite_moves_nothing(tiny):
    poses = Poses.of(tiny.cameras, tiny.truth.means)
    moved = poses.update(0, tiny.cameras[0], np.full(6, np.nan), 0.05)
    np.testing.assert_allclose(moved.viewmat, tiny.cameras[0].viewmat, atol=1e-15)
    assert not poses.steps.any()


def test_a_step_moves_the_picture_by_about_its_rate(tiny):
    poses, camera = Poses.of(tiny.cameras, tiny.truth.means), tiny.cameras[0]
    moved = poses.update(0, camera, np.array([1.0, 0, 0, 0, 0, 0]), 0.5)
    assert beside(camera, moved, tiny.truth.means) == pytest.approx(0.5, rel=0.3)


@pytest.mark.parametrize("words", [["--quick"], []])
def test_without_photographs_it_is_refused(splat, tmp_path, svrgs, words):
    found = svrgs(
        "prune", splat, "--target", 0.5, "--refine-poses", "on", "--out", tmp_path / "o.ply", *words
    )
    assert found.status == 2 and "--refine-poses" in found.err


def test_a_view_is_as_far_beside_another_as_most_of_what_it_shows(tiny):
    camera = tiny.cameras[0]
    means = np.concatenate([np.zeros((9, 3)), camera.position[None] * 0.9])  # one close before the camera
    moved = camera.displaced(np.array([0, 0, 0, 0.03, 0, 0]))
    assert pose_alignment.beside(camera, moved, means) == pytest.approx(0.03 * camera.K[0, 0] / 3, rel=0.1)
