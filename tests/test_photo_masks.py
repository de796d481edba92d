"""Masks of photographs: what they hide counts nowhere, and what is wrong with them is said."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

import tiny_dataset
from native_helpers import LEVELS, rasterizer
from svrgs_addon.files.images import read_pixels, write_image
from svrgs_addon.jobs import photo_mask
from svrgs_addon.jobs.farm.farm_job import FarmJob
from svrgs_addon.jobs.farm.run_tasks import dataset_sha256
from svrgs_addon.jobs.photo_sample import read_in_child
from svrgs_addon.native.rasterizer import RenderOptions
from svrgs_addon.render.metrics import flip_map
from svrgs_addon.render.metrics.evaluate import mean_figures
from svrgs_addon.render.metrics.explained import fit, sample_views
from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.views.dataset import Dataset, load_dataset
from svrgs_addon.views.valid_pixels import MaskOptions
from svrgs_bench.scenes import orbit_camera, room
from transforms_dataset import write_transforms

WIDTH, HEIGHT = 96, 70


def pattern(height: int, width: int) -> np.ndarray:
    """(H, W) uint8: a hole across tiles and blocks, a border, and single pixels; 1 counts."""
    valid = np.ones((height, width), np.uint8)
    valid[height // 5 : height // 2, width // 3 : 2 * width // 3] = 0
    valid[:, -3:] = 0
    valid[np.random.default_rng(0).random((height, width)) < 0.05] = 0
    return valid


@pytest.fixture
def masked(tiny, tmp_path) -> Path:
    """A copy of the tiny dataset with a mask for each photograph, masks/NAME.png."""
    folder = tmp_path / "masked"
    shutil.copytree(tiny.folder, folder)
    for photo in sorted((folder / "images").iterdir()):
        height, width = read_pixels(photo).shape[:2]
        write_mask(folder / "masks" / f"{photo.stem}.png", pattern(height, width))
    return folder


def write_mask(path: Path, valid: np.ndarray):
    path.parent.mkdir(exist_ok=True)
    write_image(path, np.where(valid, 255, 0).astype(np.uint8))


def hide(folder: Path, colour: int):
    """Paints all that the masks of a dataset leave out."""
    for photo in sorted((folder / "images").iterdir()):
        pixels = read_pixels(photo)
        pixels[pattern(*pixels.shape[:2]) == 0] = colour
        write_image(photo, pixels)


def test_the_order_of_a_mask_in_memory_does_not_matter():
    camera, valid = orbit_camera(WIDTH, HEIGHT), pattern(HEIGHT, WIDTH)
    for order in (valid, np.asfortranarray(valid), np.repeat(valid, 2, axis=1)[:, ::2]):
        found = camera.masked(order).valid
        np.testing.assert_array_equal(found, valid)
        assert found.flags.c_contiguous


# --- reading


@pytest.mark.parametrize("name", ["{name}.png", "{stem}.png", "{stem}.PNG"])
def test_masks_beside_the_photographs_are_found_by_their_names(masked, name):
    for mask in sorted((masked / "masks").iterdir()):
        photo = next((masked / "images").glob(f"{mask.stem}.*"))
        mask.rename(mask.with_name(name.format(name=photo.name, stem=mask.stem)))
    data = load_dataset(masked)
    expected = pattern(data.cameras[0].height, data.cameras[0].width)
    for index, camera in enumerate(data.cameras):
        np.testing.assert_array_equal(camera.valid, expected)
        assert (data.image(index)[expected == 0] == 0).all() and data.image(index)[expected == 1].any()
    (note,) = data.notes
    assert f"{len(data.cameras)} of {len(data.cameras)} photographs have a mask; " in note
    assert f"{1 - expected.mean():.1%} of their pixels count nowhere" in note


def test_masks_that_transforms_json_names_and_those_of_a_given_folder(tiny, masked, tmp_path):
    from svrgs_addon.views.colmap import read_model

    other = tmp_path / "nerfstudio"
    other.mkdir()
    (other / "images").symlink_to(masked / "images")
    shutil.copytree(masked / "masks", other / "elsewhere")
    names = {
        f"./images/{photo.name}": f"elsewhere/{photo.stem}.png" for photo in (masked / "images").iterdir()
    }
    facts = write_transforms(other, read_model(tiny.folder / "sparse/0"))
    facts["frames"] = [frame | {"mask_path": names[frame["file_path"]]} for frame in facts["frames"]]
    rewrite(other, facts)
    valid = load_dataset(masked).cameras[0].valid
    camera = load_dataset(other).cameras[0]
    np.testing.assert_array_equal(camera.valid, valid)
    found = photo_mask.read_in_child(str(other), "", camera.name, [MaskOptions()])
    np.testing.assert_array_equal(found, valid)
    given = load_dataset(tiny.folder, masks=MaskOptions(masked / "masks"))
    np.testing.assert_array_equal(given.cameras[0].valid, valid)
    inverted = load_dataset(tiny.folder, masks=MaskOptions(masked / "masks", inverted=True))
    np.testing.assert_array_equal(inverted.cameras[0].valid, 1 - valid)


def rewrite(folder: Path, facts: dict):
    import json

    (folder / "transforms.json").write_text(json.dumps(facts))


def test_what_does_not_count_may_be_painted_with_the_background(masked):
    options = MaskOptions(outside="background")
    data = load_dataset(masked, background=(1.0, 0.5, 0.0), masks=options)
    photo, plain = data.image(0), load_dataset(masked, masks=options).image(0)
    outside = pattern(*photo.shape[:2]) == 0
    assert data.cameras[0].valid is None and (photo[outside] == (255, 128, 0)).all()
    assert (plain[outside] == 0).all() and (photo[~outside] == plain[~outside]).all()


def test_transparent_pixels_are_painted_or_left_out(tiny, tmp_path):
    folder = tmp_path / "alpha"
    shutil.copytree(tiny.folder, folder)
    import OpenImageIO as oiio

    for photo in sorted((folder / "images").iterdir()):
        pixels = read_pixels(photo)
        alpha = 255 * pattern(*pixels.shape[:2])[..., None]
        photo.unlink()
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 4, "uint8")
        spec.attribute("oiio:UnassociatedAlpha", 1)
        out = oiio.ImageOutput.create(str(photo.with_suffix(".png")))
        out.open(str(photo.with_suffix(".png")), spec)
        out.write_image(np.concatenate([pixels, alpha], axis=2))
        out.close()
    assert load_dataset(folder).cameras[0].valid is None
    camera = load_dataset(folder, masks=MaskOptions(outside="ignore")).cameras[0]
    np.testing.assert_array_equal(camera.valid, pattern(camera.height, camera.width))


def test_a_mask_of_another_size_counts_where_all_of_it_does(masked):
    for mask in sorted((masked / "masks").iterdir()):
        write_mask(mask, read_pixels(mask)[..., 0].repeat(3, axis=0).repeat(3, axis=1))
    camera = load_dataset(masked).cameras[0]
    np.testing.assert_array_equal(camera.valid, pattern(camera.height, camera.width))


def test_a_reduced_pixel_counts_where_all_of_its_pixels_do():
    camera = orbit_camera(WIDTH + 1, HEIGHT + 1).masked(pattern(HEIGHT + 1, WIDTH + 1))
    blocks = pattern(HEIGHT + 1, WIDTH + 1)[:HEIGHT, :WIDTH].reshape(HEIGHT // 2, 2, WIDTH // 2, 2)
    np.testing.assert_array_equal(camera.reduced(2).valid, blocks.min(axis=(1, 3)))


def test_photographs_under_a_black_mask_are_left_out(masked):
    first = sorted((masked / "masks").iterdir())[1]
    whole = load_dataset(masked)
    write_mask(first, np.zeros(read_pixels(first).shape[:2]))
    data = load_dataset(masked)
    assert len(data.cameras) == len(whole.cameras) - 1
    assert whole.cameras[1].name not in {camera.name for camera in data.cameras}
    assert data.test_indices[0] == whole.test_indices[0] == 0
    assert "1 of the masks are black, and their photographs are left out" in data.notes[0]


def shape(folder: Path):
    write_mask(sorted((folder / "masks").iterdir())[0], np.ones((10, 50)))


def blacken(folder: Path):
    for mask in (folder / "masks").iterdir():
        write_mask(mask, np.zeros(read_pixels(mask).shape[:2]))


def damage(folder: Path):
    sorted((folder / "masks").iterdir())[0].write_bytes(b"\x89PNG\r\n\x1a\n and no more")


@pytest.mark.parametrize(
    ("change", "options", "error", "sentence"),
    [
        (
            shape,
            MaskOptions(),
            FormatError,
            r"has 50 x 10 pixels, its photograph .* the shape of its photograph",
        ),
        (blacken, MaskOptions(), SceneError, "all masks are black, so no pixel counts"),
        (damage, MaskOptions(), FormatError, "cannot be read"),
        (lambda _: None, MaskOptions(Path("/gone")), SceneError, "/gone: is no folder"),
        (lambda _: None, MaskOptions(Path("/tmp")), SceneError, "/tmp: holds no mask of these photographs"),
        (lambda f: shutil.rmtree(f / "masks"), MaskOptions(inverted=True), SceneError, "has no masks"),
    ],
    ids=["shape", "black", "damaged", "no folder", "empty folder", "nothing to invert"],
)
def test_what_is_wrong_with_masks_is_said(masked, change, options, error, sentence):
    change(masked)
    with pytest.raises(error, match=sentence):
        load_dataset(masked, masks=options)


# --- rendering


def scene_of(level: str):
    from types import SimpleNamespace

    r, scene = rasterizer(level), room(3000, 1)
    names = ("means", "log_scales", "quats", "opacity_logits", "sh")
    arrays = {name: np.ascontiguousarray(getattr(scene, name), r.dtype) for name in names}
    return r, SimpleNamespace(**arrays, count=scene.count, antialiased=False)


def views() -> tuple[Camera, Camera, np.ndarray]:
    """A view without and with a mask, and its pixels that count, bool."""
    camera, valid = orbit_camera(WIDTH, HEIGHT), pattern(HEIGHT, WIDTH)
    return camera, camera.masked(valid), valid.astype(bool)


@pytest.mark.parametrize("full", [False, True])
@pytest.mark.parametrize("kind", ["none", "svr", "self", "a", "b"])
@pytest.mark.parametrize("level", LEVELS)
def test_pixels_that_do_not_count_show_nothing_and_the_others_the_same_bits(level, kind, full):
    r, scene = scene_of(level)
    whole, _, valid = views()
    valid[:6] = valid[:, :9] = False
    masked = whole.masked(valid)
    options, outputs = RenderOptions(mask_kind=kind, full=full), ("rgb", "mask", "hits", "kept", "depth")
    masks = (np.arange(scene.count) % 5 > 0).astype(np.uint8)
    plain = r.forward(scene, whole, options, masks, outputs)
    rng = np.random.default_rng(1)
    grads = {"rgb": rng.normal(size=(HEIGHT, WIDTH, 3)).astype(r.dtype)}
    grads |= {} if kind == "none" else {"mask": rng.normal(size=(HEIGHT, WIDTH)).astype(r.dtype)}
    zeroed = {
        name: grad * valid.reshape(*valid.shape, *[1] * (grad.ndim - 2)) for name, grad in grads.items()
    }
    expected, seen = {name: grad.copy() for name, grad in r.backward(zeroed).items()}, r.visible()
    found = r.forward(scene, masked, options, masks, outputs)
    for name in outputs:
        np.testing.assert_array_equal(found[name][valid], plain[name][valid], err_msg=name)
        assert not found[name][~valid].any(), name
    skipped = ~np.isin(seen, r.visible())  # those that miss the rectangle of the pixels that count
    assert skipped.any()
    for name, grad in r.backward(grads).items():
        np.testing.assert_array_equal(grad, expected[name][~skipped], err_msg=name)
        assert not expected[name][skipped].any()


@pytest.mark.parametrize("level", LEVELS)
def test_statistics_count_only_pixels_that_count(level):
    """Against the difference of pictures, and against the sums over the view without a mask."""
    r, scene = scene_of(level)
    whole, masked, valid = views()
    r.forward(scene, whole, outputs=())
    hits_of_all = np.zeros(scene.count, np.int64)
    r.add_scores(hits=hits_of_all)
    image = r.forward(scene, masked)["rgb"].copy()
    hits, cost = np.zeros(scene.count, np.int64), np.zeros(scene.count)
    r.add_scores(hits=hits)
    r.add_removal(cost, np.zeros((HEIGHT, WIDTH, 3), r.dtype))
    r.forward(scene, whole.masked(1 - valid.astype(np.uint8)), outputs=())
    others = np.zeros(scene.count, np.int64)
    r.add_scores(hits=others)
    np.testing.assert_array_equal(hits + others, hits_of_all)
    assert 0 < hits.sum() < hits_of_all.sum()
    for row in np.argsort(-cost)[:20:5]:
        without = np.ones(scene.count, np.uint8)
        without[row] = 0
        change = (r.forward(scene, masked, masks=without)["rgb"] - image) ** 2
        assert cost[row] == pytest.approx(change.sum(), rel=2e-3)


# --- measuring


def test_errors_are_means_over_the_pixels_that_count():
    rng, valid = np.random.default_rng(2), pattern(HEIGHT, WIDTH).astype(bool)
    image, photo = (rng.random((HEIGHT, WIDTH, 3)).astype(np.float32) * valid[..., None] for _ in range(2))
    found = mean_figures([(image, photo, valid.astype(np.uint8))], lambda *_: 0.25)
    assert found["lpips"] == pytest.approx(0.25 / valid.mean())
    error = ((image - photo)[valid] ** 2).mean()
    assert found["psnr"] == pytest.approx(-10 * np.log10(error), abs=1e-4)
    whole = mean_figures([(image, photo, None)])
    assert found["flip"] == pytest.approx(flip_map(image, photo)[valid].mean())
    assert 1 - found["ssim"] == pytest.approx((1 - whole["ssim"]) / valid.mean())


def test_equal_pictures_count_as_100_db_among_others_and_as_infinite_alone():
    image, other = np.zeros((16, 16, 3), np.float32), np.full((16, 16, 3), 0.1, np.float32)
    assert mean_figures([(image, image, None), (image, other, None)])["psnr"] == pytest.approx(60, abs=1e-4)
    assert mean_figures([(image, image, None)])["psnr"] == np.inf


# --- whole jobs


def twins(masked: Path, folder: Path) -> tuple[Path, Path]:
    """Two datasets that differ only under their masks."""
    for name, colour in (("dark", 0), ("bright", 255)):
        shutil.copytree(masked, folder / name)
        hide(folder / name, colour)
    return folder / "dark", folder / "bright"


@pytest.mark.parametrize("method", ["removal", "maskgs", "svr", "lightgaussian"])
def test_what_a_mask_hides_changes_no_bit_of_a_pruned_splat(tiny, masked, tmp_path, svrgs, method):
    results = []
    for data in twins(masked, tmp_path):
        out = tmp_path / f"{data.name}.ply"
        steps = ["--iterations", 12, "--recovery", 8, "--target", 0.5]
        result = svrgs(
            "prune", tiny.splat, "--data", data, "--method", method, *steps, "--out", out, "--json"
        )
        assert any("photographs have a mask" in note for note in result.json["notes"])
        hidden = [one["hidden"] for one in result.json["photographs"].values()]
        assert hidden == pytest.approx(
            [1 - pattern(tiny_dataset.HEIGHT, tiny_dataset.WIDTH).mean()] * len(hidden)
        )
        results.append((out.read_bytes(), result.json["psnr"], result.json["ssim"], result.json["flip"]))
    assert results[0] == results[1]


def test_masks_change_the_result_and_training_sees_them(tiny, masked, tmp_path, svrgs):
    dark, bright = twins(masked, tmp_path)
    trained = {}
    for name, data, more in (
        ("dark", dark, ()),
        ("bright", bright, ()),
        ("painted", bright, ("--outside", "background")),
    ):
        out = tmp_path / f"{name}-trained.ply"
        words = ["train", "--data", data, "--iterations", 20, "--out", out, *more]
        assert svrgs(*words).status == 0
        trained[name] = out.read_bytes()
    assert trained["dark"] == trained["bright"] != trained["painted"]


def test_torch_learns_from_the_same_pixels(tiny, masked, tmp_path, svrgs):
    pytest.importorskip("torch")
    data = load_dataset(masked)
    assert isinstance(data, Dataset) and data.cameras[0].valid is not None
    out = {}
    for engine in ("native", "torch"):
        path = tmp_path / f"{engine}.ply"
        words = ["--data", masked, "--engine", engine, "--iterations", 4, "--recovery", 2, "--target", 0.5]
        out[engine] = svrgs("prune", tiny.splat, *words, "--out", path, "--json").json
    assert out["native"]["psnr"] == pytest.approx(out["torch"]["psnr"], abs=0.05)


@pytest.mark.slow
def test_by_blocks_what_a_mask_hides_changes_no_bit(tiny, masked, tmp_path, svrgs):
    results = []
    for data in twins(masked, tmp_path):
        out = tmp_path / f"{data.name}.ply"
        words = ["--data", data, "--method", "removal", "--iterations", 12, "--recovery", 8, "--block", 120]
        found = svrgs("large", "prune", tiny.splat, *words, "--target", 0.4, "--out", out, "--json").json
        results.append((out.read_bytes(), found["psnr"]))
    assert results[0] == results[1]


@pytest.mark.parametrize("words", [["--masks", "m"], ["--invert-masks"], ["--outside", "ignore"]])
def test_masks_without_photographs_are_refused(tiny, tmp_path, svrgs, words):
    splat = tmp_path / "alone.ply"
    shutil.copy(tiny.splat, splat)
    for command in (["prune", splat, "--target", 0.5, "--out"], ["compare", splat, splat, "--out"]):
        found = svrgs(*command, tmp_path / "o.ply", *words)
        assert found.status == 2
        assert f"{words[0]} is of the photographs of a dataset: give --data" in found.err
    assert list(tmp_path.iterdir()) == [splat]


def test_another_mask_is_another_dataset_to_a_farm(masked):
    before, given = dataset_sha256(masked, ""), MaskOptions(masked / "other")
    shutil.copytree(masked / "masks", masked / "other")
    assert dataset_sha256(masked, "", given) == before
    first = sorted((masked / "other").iterdir())[0]
    write_mask(first, np.ones(read_pixels(first).shape[:2]))
    assert dataset_sha256(masked, "", given) != before == dataset_sha256(masked, "")
    shutil.rmtree(masked / "masks")
    assert dataset_sha256(masked, "") != before


def test_a_farm_finds_masks_from_another_working_directory(masked, tmp_path, svrgs, monkeypatch):
    monkeypatch.chdir(masked)
    words = ["--target", 0.5, "--masks", "masks", "--iterations", 5, "--recovery", 0]
    assert svrgs("farm", "export", masked, "--out", tmp_path / "job", *words).status == 0
    monkeypatch.chdir(tmp_path)
    job = FarmJob.read(tmp_path / "job")
    assert [job.options(task).masks for task in job.tasks] == [masked / "masks"]


def test_a_batch_of_a_folder_takes_masks(masked, tmp_path, svrgs):
    words = ["--target", 0.5, "--masks", masked / "masks", "--iterations", 5, "--recovery", 0]
    found = svrgs(
        "prune", masked / "scene.ply", "--batch", "--data", masked, "--out", tmp_path / "out", *words
    )
    assert found.status == 0 and "12 of 12 photographs have a mask" in found.err


def test_transparent_pixels_are_left_out_beside_a_mask_too(masked):
    import OpenImageIO as oiio

    for photo in sorted((masked / "images").iterdir()):
        pixels = read_pixels(photo)
        alpha = np.full((*pixels.shape[:2], 1), 255, np.uint8)
        alpha[: len(alpha) // 2] = 0
        spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], 4, "uint8")
        out = oiio.ImageOutput.create(str(photo))
        out.open(str(photo), spec)
        out.write_image(np.concatenate([pixels, alpha], axis=2))
        out.close()
    camera = load_dataset(masked, masks=MaskOptions(outside="ignore")).cameras[0]
    expected = pattern(camera.height, camera.width)
    expected[: camera.height // 2] = 0
    np.testing.assert_array_equal(camera.valid, expected)


def test_a_view_of_a_few_pixels_is_compared_at_full_size(tiny, masked):
    for mask in sorted((masked / "masks").iterdir()):
        few = np.zeros(read_pixels(mask).shape[:2])
        few[10:13, 10:13] = 1
        write_mask(mask, few)
    camera = load_dataset(masked).cameras[0]
    assert camera.reduced(4).valid_share == 0 and camera.reducible(4) == 1 and camera.reducible(2) == 2
    from svrgs_addon.render.metrics import explained

    kept, explained.SAMPLED_SIDE = explained.SAMPLED_SIDE, 12
    try:
        found = fit(tiny.truth, sample_views(load_dataset(masked)))
    finally:
        explained.SAMPLED_SIDE = kept
    assert found["psnr"] > 30


def test_a_folder_beside_the_photographs_in_which_no_name_fits_is_said(masked):
    for mask in sorted((masked / "masks").iterdir()):
        mask.rename(mask.with_name(f"{mask.stem}_mask.png"))
    data = load_dataset(masked)
    assert data.cameras[0].valid is None
    assert "holds no mask of these photographs, so all of their pixels count" in data.notes[0]


def test_a_look_whether_the_splat_belongs_takes_masks_along(tiny, masked):
    hide(masked, 255)
    views = read_in_child(str(masked), "")
    assert all(camera.valid_bits is not None for camera, _ in views)
    assert fit(tiny.truth, views)["psnr"] > 30


def test_a_child_finds_out_what_counts_in_one_photograph(tiny, masked, tmp_path):
    """The first mask that is found, as in the dataset that is loaded with the same options."""
    dataset, (black, elsewhere) = load_dataset(masked), (tmp_path / "black", tmp_path / "elsewhere")
    camera = dataset.cameras[3]
    write_mask(elsewhere / f"{camera.name}.png", np.zeros((camera.height, camera.width)))
    black.mkdir()
    ask = lambda folder, *masks, name=camera.name: photo_mask.read_in_child(str(folder), "", name, masks)
    np.testing.assert_array_equal(ask(masked, MaskOptions(black), MaskOptions()), camera.valid)
    np.testing.assert_array_equal(ask(masked, MaskOptions(inverted=True)), 1 - camera.valid)
    assert not ask(masked, MaskOptions(elsewhere), MaskOptions()).any()
    assert ask(tiny.folder, MaskOptions()) is None
    with pytest.raises(SceneError, match=r"has no view away\.png"):
        ask(masked, MaskOptions(), name="away.png")
