"""SOG as output: tables and palettes with little error where it is seen, a folder that is replaced as a
whole, the same bytes each time."""

from __future__ import annotations

import json
import zipfile
from itertools import combinations

import numpy as np
import pytest

from svrgs_addon.files import sog_writer
from svrgs_addon.files.palette import nearest, palette, table
from svrgs_addon.files.quantised import picture_weights
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.scene.morton_order import morton_order
from svrgs_addon.system.errors import SceneError
from test_formats import differences, like_trained


@pytest.fixture
def rng() -> np.random.Generator:
    return np.random.default_rng(0)


def error_of(values: np.ndarray, weights: np.ndarray, levels: np.ndarray) -> float:
    return float((weights * np.square(values[:, None] - levels[None]).min(axis=1)).sum())


def test_a_table_is_nearly_the_best_one(rng):
    values, weights = rng.normal(size=40), rng.uniform(0.1, 3, 40)
    order = np.argsort(values)
    best = np.inf
    for cuts in combinations(range(1, 40), 2):  # every way to cut the sorted values into three
        parts = np.split(order, cuts)
        best = min(
            best,
            error_of(
                values, weights, np.array([np.average(values[part], weights=weights[part]) for part in parts])
            ),
        )
    assert error_of(values, weights, table(values, weights, 3)) <= 1.1 * best


def test_a_table_holds_few_values_exactly(rng):
    values = rng.choice(rng.normal(size=200).astype(np.float32), 5000)
    levels = table(values, np.ones(5000), 256)
    assert levels.shape == (256,) and (np.diff(levels) >= 0).all()
    assert (levels[nearest(values, levels)] == values).all()


def test_a_table_is_finer_where_weights_are_large(rng):
    values = rng.uniform(-1, 1, 20_000)
    levels = table(values, np.where(values > 0, 100.0, 1.0), 256)
    assert (levels > 0).sum() > 1.5 * (levels < 0).sum()


def test_a_palette_has_the_rows_that_weigh_most(rng):
    rows, weights = rng.normal(size=(4000, 9)).astype(np.float32), rng.uniform(size=4000) ** 8
    entries, labels = palette(rows, weights, 500, 65_536)
    error = np.square(rows - entries[labels]).sum(axis=1)
    assert len(entries) <= 500 and labels.max() < len(entries)
    assert (weights * error).sum() < 0.5 * weights.sum() * error.mean()
    assert error.mean() < np.square(rows - rows.mean(axis=0)).sum(axis=1).mean()


def test_rows_out_of_a_palette_are_kept(rng):
    source = rng.normal(size=(700, 9)).astype(np.float32)
    rows = source[rng.integers(0, 700, 6000)]
    entries, labels = palette(rows, np.ones(6000), 100, 65_536)
    assert (entries[labels] == rows).all()


def test_a_palette_with_more_rows_than_a_file_holds_is_made_anew(rng):
    rows = rng.normal(size=(50, 9)).astype(np.float32).repeat(10, axis=0)
    assert len(palette(rows, np.ones(500), 10, 50)[0]) == 50
    assert len(palette(rows, np.ones(500), 10, 49)[0]) <= 10


def test_a_sog_of_a_sog_is_the_same_scene(tmp_path):
    write_scene(tmp_path / "a.sog", like_trained(2, 9000))
    first = read_scene(tmp_path / "a.sog")
    first = first.select(morton_order(first.means))
    write_scene(tmp_path / "b.sog", first)
    found = differences(first, read_scene(tmp_path / "b.sog"))
    assert found.pop("turn") < 0.02 and found.pop("means") < 1e-4
    assert max(found.values()) < 1e-5, found


def test_values_that_weigh_are_exact(tmp_path):
    scene = like_trained(3, 9000)
    weights = picture_weights(scene)
    meta, textures = sog_writer.encoded(scene)
    levels = np.array(meta["sh0"]["codebook"])
    stored = levels[textures["sh0"].reshape(-1, 4)[:9000, :3]]
    assert np.abs(stored - scene.sh[:, 0])[weights > 1].max() < 0.04
    assert set(meta["shN"]) == {"count", "bands", "codebook", "files"} and meta["shN"]["count"] <= 65_536


def test_the_few_large_gaussians_of_a_sky_keep_their_scales(tmp_path, rng):
    scene = like_trained(0, 20_000)
    scene.log_scales[:] = rng.normal(-5, 1.2, scene.log_scales.shape)
    sky = np.arange(100)
    scene.log_scales[sky], scene.opacity_logits[sky] = rng.uniform(0, 5, (100, 3)), 2.0
    scene = scene.select(morton_order(scene.means))
    write_scene(tmp_path / "a.sog", scene)
    wrong = np.abs(read_scene(tmp_path / "a.sog").log_scales - scene.log_scales)
    large = (scene.log_scales > 0).all(axis=1)
    assert large.sum() == 100 and wrong[large].max() < 0.1 and wrong[~large].mean() < 0.03


def test_the_same_scene_gives_the_same_bytes(tmp_path):
    scene = like_trained(1, 3000)
    for name in ("a.sog", "b.sog"):
        write_scene(tmp_path / name, scene)
    assert (tmp_path / "a.sog").read_bytes() == (tmp_path / "b.sog").read_bytes()
    assert zipfile.ZipFile(tmp_path / "a.sog").namelist()[0] == "meta.json"


def test_a_folder_is_replaced_as_a_whole(tmp_path, monkeypatch):
    out = tmp_path / "new" / "meta.json"
    write_scene(out, like_trained(1, 300))
    assert {file.name for file in out.parent.iterdir()} == {"meta.json", *(f"{name}.webp" for name in NAMES)}
    before = read_scene(out)
    (out.parent / "photo.webp").write_bytes(b"mine")

    def full(*_):
        raise SceneError("no space")

    with monkeypatch.context() as broken:
        broken.setattr(sog_writer, "write_texture", full)
        with pytest.raises(SceneError, match="no space"):
            write_scene(out, like_trained(1, 500))
    assert differences(before, read_scene(out.parent)) == dict.fromkeys(differences(before, before), 0)
    write_scene(out, like_trained(1, 500))
    assert read_scene(out.parent).count == 500 and len(list(out.parent.iterdir())) == 2 + len(NAMES)
    assert (out.parent / "photo.webp").read_bytes() == b"mine"
    named = [
        name
        for part in json.loads(out.read_text()).values()
        if isinstance(part, dict)
        for name in part.get("files", ())
    ]
    assert len(named) == len(NAMES) and all((out.parent / name).is_file() for name in named)


NAMES = ("means_l", "means_u", "scales", "quats", "sh0", "shN_centroids", "shN_labels")


def test_positions_in_coarse_steps_are_told(tmp_path, caplog):
    scene = like_trained(0, 300)
    scene.log_scales[:] = -12
    scene.means[0] = 1e6
    write_scene(tmp_path / "a.sog", scene)
    assert "steps of" in caplog.text and "1e+06" in caplog.text


def test_steps_that_are_twice_as_large_allow_four_times_the_error(rng, monkeypatch):
    rows, weights = rng.normal(size=(500, 9)).astype(np.float32), np.ones(500, np.float32)

    def is_coarsest(error: float, factor: float) -> bool:
        monkeypatch.setattr(sog_writer, "SMALL_ERROR", error)
        return sog_writer._share(rows, weights, factor, None) == sog_writer.SHARES[0]

    enough = next(error for error in np.geomspace(1, 20, 60) if is_coarsest(error, 1.0))
    assert is_coarsest(enough / 4, 2.0) and not is_coarsest(enough / 4, 1.9)
