"""Exposure of photographs: matrices are fitted, differ from photograph to photograph alone, and are used
where they are needed; pictures in the colours of their photographs."""

from __future__ import annotations

import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from job_checks import create, follow
from native_helpers import LEVELS
from plans import prune_settings
from short_runs import whole_and_taken_up
from svrgs_addon.files.images import linear_to_srgb, read_image, srgb_to_linear, write_image
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.finetune.engine import NativeEngine, Step
from svrgs_addon.finetune.exposure import IDENTITY, Exposures, stops
from svrgs_addon.finetune.model import Model
from svrgs_addon.finetune.run import Run
from svrgs_addon.finetune.settings import Rates
from svrgs_addon.jobs.job_process import Job
from svrgs_addon.native import library
from svrgs_addon.native.pictures import exposed, exposed_vjp
from svrgs_addon.native.rasterizer import Rasterizer, RenderOptions
from svrgs_addon.prune.door import given
from svrgs_addon.prune.options import PruneOptions
from svrgs_addon.prune.tone_check import tone_of
from svrgs_addon.render.metrics import psnr
from svrgs_addon.render.metrics.colour_match import colour_matched
from svrgs_addon.views.dataset import load_dataset
from svrgs_addon.views.reduced_photos import toned

LARGEST = 0.3  # EV
EXPOSED_BOUND = {"float64": 1e-13}  # of colours up to 1 and their gradients; of the other levels in the test
STEPS = ("--iterations", 100, "--recovery", 200, "--target", 0.5)


def drifts(count: int) -> np.ndarray:
    """EV of each photograph; those that are held out are as they were."""
    return np.where(np.arange(count) % 8, np.random.default_rng(0).uniform(-LARGEST, LARGEST, count), 0.0)


def drift(folder: Path):
    photos = sorted((folder / "images").iterdir())
    for photo, ev in zip(photos, drifts(len(photos)), strict=True):
        write_image(photo, linear_to_srgb(srgb_to_linear(read_image(photo)) * 2**ev).clip(0, 1))


@pytest.fixture
def drifting(tiny, tmp_path) -> Path:
    """The tiny dataset, each of whose photographs has another exposure."""
    folder = tmp_path / "drifting"
    shutil.copytree(tiny.folder, folder)
    drift(folder)
    return folder


def some_matrix() -> np.ndarray:
    return IDENTITY + np.random.default_rng(1).normal(0, 0.1, (3, 4))


# --- the matrices


@pytest.mark.parametrize("with_mask", [False, True])
def test_the_gradient_is_that_of_finite_differences(with_mask):
    rng = np.random.default_rng(0)
    rgb, weights, matrix = rng.random((7, 5, 3)), rng.normal(size=(7, 5, 3)), some_matrix()
    valid = (rng.random((7, 5)) < 0.7).astype(np.uint8) if with_mask else None
    seen = lambda colours, m: exposed(colours, m, valid, "float64")
    value = lambda colours, m: float((weights * seen(colours, m) ** 2).sum())
    d_rgb, d_matrix = exposed_vjp(2 * weights * seen(rgb, matrix), rgb, matrix, valid, "float64")
    step = 1e-6
    for array, grad, call in (
        (rgb, d_rgb, lambda x: value(x, matrix)),
        (matrix, d_matrix, lambda x: value(rgb, x)),
    ):
        for place in zip(*np.unravel_index(rng.choice(array.size, 10), array.shape), strict=True):
            ends = [array.copy(), array.copy()]
            ends[0][place] += step
            ends[1][place] -= step
            slope = (call(ends[0]) - call(ends[1])) / (2 * step)
            assert grad[place] == pytest.approx(slope, rel=1e-6, abs=1e-8)


@pytest.mark.parametrize("level", LEVELS)
@pytest.mark.parametrize("with_mask", [False, True])
# ends within a vector, and within a task of the pool
@pytest.mark.parametrize("size", [(1, 1), (3, 37), (90, 101)], ids=str)
def test_every_level_gives_the_colours_and_gradients_of_float64(level, with_mask, size):
    rng, dtype = np.random.default_rng(2), np.float64 if level == "float64" else np.float32
    rgb, d_seen = rng.random((*size, 3)).astype(dtype), rng.normal(size=(*size, 3)).astype(dtype)
    valid, matrix = (rng.random(size) < 0.7).astype(np.uint8) if with_mask else None, some_matrix()
    counts = np.ones((*size, 1)) if valid is None else valid[..., None]
    wide = [array.astype(np.float64) for array in (rgb, d_seen * counts)]
    seen = (wide[0] @ matrix[:, :3].T + matrix[:, 3]) * counts
    assert np.abs(exposed(rgb, matrix, valid, level) - seen).max() <= EXPOSED_BOUND.get(level, 5e-7)
    d_rgb, d_matrix = exposed_vjp(d_seen, rgb, matrix, valid, level)
    assert d_rgb.dtype == dtype
    assert np.abs(d_rgb - wide[1] @ matrix[:, :3]).max() <= EXPOSED_BOUND.get(level, 8e-7)
    expected = np.column_stack([np.einsum("hwk,hwj->kj", wide[1], wide[0]), wide[1].sum(axis=(0, 1))])
    error = np.linalg.norm(d_matrix - expected) / max(1e-3, np.linalg.norm(expected))
    assert error <= EXPOSED_BOUND.get(level, 2e-6)  # worst seen 1.2e-6


def test_the_gradient_of_a_matrix_does_not_depend_on_threads():
    rng, found = np.random.default_rng(3), []
    rgb, d_seen = rng.random((2, 150, 131, 3), np.float32)
    for threads in (1, 3, 7):
        library.set_threads(threads)
        found.append(exposed_vjp(d_seen, rgb, some_matrix(), None)[1])
    library.set_threads(0)
    np.testing.assert_array_equal(found[0], found[1])
    np.testing.assert_array_equal(found[0], found[2])


@pytest.mark.parametrize("with_mask", [False, True])
def test_both_engines_give_the_same_gradients(tiny, with_mask):
    torch_engine = pytest.importorskip("svrgs_addon.finetune.torch_engine")
    camera, found = tiny.cameras[1], []
    if with_mask:
        camera = camera.masked(np.arange(camera.height * camera.width).reshape(camera.height, -1) % 5)
    for engine in (NativeEngine("float64"), torch_engine.TorchEngine("float64")):
        model = Model.of(tiny.truth, np.dtype(np.float64))
        target = np.random.default_rng(0).random((camera.height, camera.width, 3))
        target = target if camera.valid is None else target * camera.valid[..., None]
        step = Step(camera, target, 1, Rates().at(1, 1.0), RenderOptions(), exposure=some_matrix())
        result = engine.step(model, step)
        found.append((result.exposure, result.l1, result.ssim, model.values["sh"]))
    for ours, other in zip(*found, strict=True):
        np.testing.assert_allclose(ours, other, rtol=1e-9, atol=1e-12)
    assert np.abs(found[0][0]).max() > 1e-3


def test_the_mean_of_all_matrices_stays_the_identity():
    exposures, rng = Exposures.identities(5), np.random.default_rng(0)
    for number in rng.integers(0, 5, 200):
        exposures.update(int(number), rng.normal(0.5, 1, (3, 4)), 0.01)
    exposures.update(1, np.full((3, 4), np.nan), 0.01)
    np.testing.assert_allclose(exposures.matrices.mean(axis=0), IDENTITY, atol=1e-14)
    assert np.abs(exposures.matrices - IDENTITY).max() > 0.05


def test_stops_of_a_matrix_are_those_of_middle_grey():
    brighter = np.concatenate([1.2 * np.eye(3), np.zeros((3, 1))], axis=1)
    expected = np.log2(srgb_to_linear(np.float32([0.6])) / srgb_to_linear(np.float32([0.5])))
    np.testing.assert_allclose(stops(np.stack([brighter, IDENTITY])), [*expected, 0], atol=1e-6)


# --- whole jobs


def pruned(svrgs, tiny, data: Path, out: Path, *words: object) -> dict:
    steps = [*STEPS, *(() if "--exposure" in words else ("--exposure", "off"))]
    return svrgs("prune", tiny.splat, "--data", data, *steps, "--out", out, *words, "--json").json


def test_what_drifts_is_fitted_and_written_beside_the_result(tiny, drifting, tmp_path, svrgs):
    plain = pruned(svrgs, tiny, drifting, tmp_path / "plain.ply")
    found = pruned(svrgs, tiny, drifting, tmp_path / "o.ply", "--exposure", "auto")
    assert found["psnr"] > plain["psnr"] + 3 and found["psnr_matched"] >= found["psnr"]
    (note,) = [note for note in found["notes"] if note.startswith("exposure varies by ±")]
    assert note.endswith("of 10 photographs, so it is fitted")
    assert plain["exposure"] is None and found["exposure"]["file"] == str(tmp_path / "o.ply_exposure.json")
    written = json.loads((tmp_path / "o.ply_exposure.json").read_text())
    names = [f"{number:02}.png" for number in range(12) if number % 8]
    truth = drifts(12)[np.arange(12) % 8 > 0]
    assert list(written) == names
    fitted = stops(np.array(list(written.values())))
    assert np.corrcoef(fitted, truth)[0, 1] > 0.97
    assert found["exposure"]["stops"] == pytest.approx(fitted.std()) == pytest.approx(truth.std(), rel=0.25)


def test_even_photographs_are_left_alone(tiny, tmp_path, svrgs):
    splat, found = tmp_path / "truth.ply", []
    write_scene(splat, tiny.truth)
    for way in ("off", "auto"):
        words = ["--data", tiny.folder, *STEPS, "--exposure", way, "--out", tmp_path / f"{way}.ply"]
        found.append(svrgs("prune", splat, *words, "--json").json)
    assert (tmp_path / "off.ply").read_bytes() == (tmp_path / "auto.ply").read_bytes()
    assert found[1]["compared"]["exposure_ev"] < 0.02 and "psnr_matched" not in found[1]
    assert found[1]["notes"] == [] and "exposure_ev" not in found[0]["compared"]
    assert {one.suffix for one in tmp_path.iterdir()} == {".ply"}


def test_matrices_of_an_earlier_result_go(tiny, drifting, tmp_path, svrgs):
    pruned(svrgs, tiny, drifting, tmp_path / "o.ply", "--exposure", "on")
    assert (tmp_path / "o.ply_exposure.json").exists()
    pruned(svrgs, tiny, drifting, tmp_path / "o.ply", "--overwrite")
    assert not (tmp_path / "o.ply_exposure.json").exists()


def test_eval_measures_in_the_colours_of_the_photographs_if_asked(tiny, drifting, svrgs):
    words = ["eval", tiny.splat, "--data", drifting, "--split", "train"]
    plain, matched = svrgs(*words, "--json").json, svrgs(*words, "--matched", "--json").json
    assert matched["psnr_matched"] > plain["psnr"] == matched["psnr"] and "psnr_matched" not in plain
    assert "PSNR in the photographs' colours" in svrgs(*words, "--matched").out


def test_masks_hide_from_the_fit_too(tiny, drifting, tmp_path, svrgs):
    (drifting / "masks").mkdir()
    for photo in (drifting / "images").iterdir():
        white = np.full((48, 64), 255, np.uint8)
        white[10:30, 20:50] = 0
        write_image(drifting / "masks" / photo.name, white)
    results = []
    for value in (0.0, 1.0):
        for photo in (drifting / "images").iterdir():
            pixels = read_image(photo)
            pixels[10:30, 20:50] = value
            write_image(photo, pixels)
        out = tmp_path / f"{value}.ply"
        found = pruned(svrgs, tiny, drifting, out, "--exposure", "auto")
        results.append((out.read_bytes(), found["psnr_matched"], found["exposure"]["stops"]))
    assert results[0] == results[1]


def test_a_run_that_is_taken_up_again_gives_the_same_matrices(drifting, tiny, tmp_path):
    data, plan = load_dataset(drifting), prune_settings("removal", 12, 8, target=100)
    plan = replace(plan, exposure="on")

    def run() -> Run:
        return Run(Model.of(read_scene(tiny.splat)), data, plan, NativeEngine())

    whole, second = whole_and_taken_up(run, tmp_path / "kept")
    np.testing.assert_array_equal(whole.exposures.matrices, second.exposures.matrices)
    np.testing.assert_array_equal(whole.model.values["sh"], second.model.values["sh"])


def test_training_fits_exposure_if_it_is_told_to(drifting, tmp_path, svrgs):
    words = ["train", "--data", drifting, "--iterations", 60]
    for way in ("auto", "off", "on"):
        svrgs(*words, "--exposure", way, "--out", tmp_path / f"{way}.ply", "--json")
    assert len(json.loads((tmp_path / "on.ply_exposure.json").read_text())) == 10
    assert len([*tmp_path.glob("*_exposure.json")]) == 1
    assert (tmp_path / "auto.ply").read_bytes() == (tmp_path / "off.ply").read_bytes()


@pytest.mark.parametrize("words", [["--quick"], []])
def test_without_photographs_it_is_refused(tiny, tmp_path, svrgs, words):
    splat = tmp_path / "alone.ply"
    shutil.copy(tiny.splat, splat)
    found = svrgs("prune", splat, "--target", 0.5, "--exposure", "on", "--out", tmp_path / "o.ply", *words)
    assert found.status == 2 and "--exposure" in found.err


# --- pictures in the colours of their photographs


def test_another_white_balance_does_not_count(tiny):
    photo = Rasterizer().forward(tiny.truth, tiny.cameras[0])["rgb"].clip(0, 1)
    image = (0.05 + photo * [0.7, 0.8, 0.6]).astype(np.float32)
    assert psnr(image, photo) < 25 and psnr(colour_matched(image, photo), photo) > 45


def test_noise_and_what_is_masked_still_count(tiny):
    rng = np.random.default_rng(0)
    photo = Rasterizer().forward(tiny.truth, tiny.cameras[0])["rgb"].clip(0, 1)
    image = (photo + rng.normal(0, 0.05, photo.shape)).clip(0, 1).astype(np.float32)
    assert psnr(colour_matched(image, photo), photo) == pytest.approx(psnr(image, photo), abs=2.0)
    valid = (rng.random(photo.shape[:2]) < 0.5).astype(np.uint8)
    hidden = np.where(valid[..., None], photo, 1 - photo)
    matched = colour_matched(image, hidden, valid)
    np.testing.assert_array_equal(matched[valid == 0], image[valid == 0])
    np.testing.assert_allclose(matched[valid == 1], colour_matched(image, photo, valid)[valid == 1])


@pytest.mark.parametrize("value", [0.0, 1.0])
def test_pictures_of_one_colour_are_left_as_they_are(value):
    image = np.full((9, 9, 3), value, np.float32)
    np.testing.assert_array_equal(colour_matched(image, 1 - image), image)


def test_a_job_of_blender_keeps_its_matrices_until_it_is_discarded(tiny, drifting, tmp_path):
    folder = create(
        tmp_path / "job", tiny, data=str(drifting), exposure="on", iterations=8, recovery=4, target=0.5
    )
    job = Job(folder)
    job.start()
    follow(job)
    assert folder.result()["exposure"]["photographs"] == 10
    assert Path(folder.result()["exposure"]["file"]).parent == folder.path
    assert (folder / "recovered.ply_exposure.json").is_file()
    folder.discard()
    assert not folder.path.exists()


# --- a splat whose colours differ as a whole


def recoloured(tiny, folder: Path, change) -> Path:
    """The tiny dataset, all its photographs changed alike."""
    shutil.copytree(tiny.folder, folder)
    for photo in (folder / "images").iterdir():
        write_image(photo, change(read_image(photo)).astype(np.float32))
    return folder


CHANGES = {
    "linear": srgb_to_linear,
    "gamma": lambda colours: colours ** (1 / 2.2),
    "gain": lambda colours: 0.6 * colours,
    "white balance": lambda colours: colours * np.float32([1, 0.75, 0.5]),
}


@pytest.mark.parametrize("name", CHANGES)
def test_photographs_of_another_tone_are_brought_to_the_colours_of_the_splat(tiny, tmp_path, svrgs, name):
    splat = tmp_path / "truth.ply"
    write_scene(splat, tiny.truth)
    data, steps = recoloured(tiny, tmp_path / "data", CHANGES[name]), ["--target", 0.8, *STEPS[:4]]
    words = ["prune", splat, *steps, "--out", tmp_path / "o.ply", "--overwrite", "--json"]
    same = svrgs(*words, "--data", tiny.folder).json
    found = svrgs(*words, "--data", data).json
    (note,) = found["notes"]
    assert note.startswith("the colours of the splat differ from those of the photographs as a whole")
    assert note.endswith("so the photographs are brought to its colours, for the figures too")
    assert same["notes"] == [] and same["compared"]["tone_db"] < 1
    assert found["psnr"] > 30  # 8 bits of linear colours are few


def test_another_tone_is_noted_if_exposure_is_left_as_it_is(tiny, tmp_path, svrgs):
    splat, data = tmp_path / "truth.ply", recoloured(tiny, tmp_path / "data", CHANGES["gain"])
    write_scene(splat, tiny.truth)
    found = pruned(svrgs, replace(tiny, splat=splat), data, tmp_path / "o.ply", "--force")
    assert any(note.endswith("brings the photographs to its colours") for note in found["notes"])


def test_what_a_splat_does_not_show_says_nothing_about_its_tone(tiny):
    """A splat of which a part was cut away, and photographs of the whole."""
    left = tiny.truth.select(np.flatnonzero(tiny.truth.means[:, 0] < 0))
    found = tone_of(left, load_dataset(tiny.folder))
    assert not found.differs


def test_a_switch_that_is_off_asks_for_nothing(tiny, tmp_path, svrgs):
    assert given(PruneOptions(exposure="off", refine_poses="off")) == []
    assert given(PruneOptions(exposure="on")) == ["exposure"]
    beside = tmp_path / "o.ply_exposure.json"
    beside.write_text("not ours")
    words = ["prune", tiny.splat, "--exposure", "off", "--refine-poses", "off", "--target", 0.5]
    svrgs(*words, "--quick", "--out", tmp_path / "o.ply", "--json")
    assert beside.read_text() == "not ours"


@pytest.mark.parametrize("dtype", [np.uint8, np.float32])
def test_a_curve_keeps_the_type_and_changes_channels_apart(dtype):
    values = np.linspace(0, 1, 256, dtype=np.float32)
    curve = np.stack([values, 0.5 * values, 1 - values])
    image = np.random.default_rng(0).integers(0, 256, (5, 4, 3)).astype(dtype)
    image = image if dtype == np.uint8 else image / np.float32(255)
    found, white = toned(image, curve), 255 if dtype == np.uint8 else 1
    assert found.dtype == dtype
    expected = np.stack([image[..., 0], 0.5 * image[..., 1], white - image[..., 2].astype(float)], axis=-1)
    np.testing.assert_allclose(found, expected, atol=0.5 * white / 255)
