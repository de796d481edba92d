"""Streamed SOG: every Gaussian of every level is in one leaf, inside its box; what viewers need is in
lod-meta.json; damaged ones are told."""

from __future__ import annotations

import dataclasses
import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial import cKDTree

from svrgs_addon.files import sog, streamed_sog
from svrgs_addon.files.reading import MAX_COUNT
from svrgs_addon.files.registry import describe, read_scene, size_on_disk, split_name, write_scene
from svrgs_addon.files.streamed_sog import read_level, write_levels
from svrgs_addon.scene.concatenate import concatenated
from svrgs_addon.scene.gaussians import Scene
from svrgs_addon.system.errors import FormatError, SceneError, TooMany
from test_formats import like_trained


def levels_of(count: int = 6000, degree: int = 1) -> list[Scene]:
    scene = like_trained(degree, count)
    return [scene, scene.select(np.arange(0, count, 2)), scene.select(np.arange(0, count, 8))]


@pytest.fixture(scope="module")
def town_written(tmp_path_factory) -> Path:
    """Three levels in leaves of at most 1,000 Gaussians; for reading only."""
    folder = tmp_path_factory.mktemp("written") / "town"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(streamed_sog, "CHUNK", 1000)
        write_levels(folder / "lod-meta.json", levels_of())
    return folder


@pytest.fixture
def town(town_written, tmp_path, monkeypatch) -> Path:
    """A copy of it."""
    monkeypatch.setattr(streamed_sog, "CHUNK", 1000)
    return Path(shutil.copytree(town_written, tmp_path / "town")) / "lod-meta.json"


@pytest.mark.slow
def test_more_than_are_read_as_a_whole_are_read_in_parts(town):
    with pytest.raises(TooMany, match="holds 6000 Gaussians, more than the limit of 5000"):
        list(read_level(town, 0, 5000))
    assert sum(part.count for part in read_level(town, 0, 6000)) == 6000
    meta = json.loads(town.read_text())
    first = leaves(meta["tree"])[0]["lods"]["0"]
    first["count"] += MAX_COUNT
    town.write_text(json.dumps(meta))
    assert describe(town)["count"] == 6000
    with pytest.raises(TooMany, match="more than the limit"):
        read_scene(town)


def test_files_with_more_gaussians_than_their_index_says_are_not_read(town):
    meta = json.loads(town.read_text())
    for leaf in leaves(meta["tree"]):
        for lod in leaf["lods"].values():
            lod["count"] = 1
    town.write_text(json.dumps(meta))
    with pytest.raises(TooMany):
        list(read_level(town, 0, 5_000))


def leaves(node: dict) -> list[dict]:
    return [leaf for child in node["children"] for leaf in leaves(child)] if "children" in node else [node]


def test_the_leaves_hold_each_gaussian_once_and_inside_their_box(town):
    meta = json.loads(town.read_text())
    assert (meta["version"], meta["lodLevels"], meta["counts"]) == (1, 3, [6000, 3000, 750])
    assert meta["count"] == 9750
    found = leaves(meta["tree"])
    assert len(found) > 8
    assert all(sum(lod["count"] for lod in leaf["lods"].values()) <= 1000 for leaf in found)
    units = {name: read_scene(town.parent / name) for name in meta["filenames"]}
    ends = dict.fromkeys(units, 0)
    for leaf in found:
        low, high = np.array(leaf["bound"]["min"]), np.array(leaf["bound"]["max"])
        for level, lod in leaf["lods"].items():
            name = meta["filenames"][lod["file"]]
            assert name.startswith(f"{level}_") and lod["offset"] == ends[name]
            ends[name] += lod["count"]
            part = units[name].select(np.arange(lod["offset"], lod["offset"] + lod["count"]))
            least = np.exp(
                part.log_scales.min(axis=1, keepdims=True)
            )  # an ellipsoid reaches as far, at least
            assert (part.means - least > low - 1e-3).all() and (part.means + least < high + 1e-3).all()
    assert ends == {name: unit.count for name, unit in units.items()}


def test_boxes_hold_those_below_them(town):
    nodes = [json.loads(town.read_text())["tree"]]
    while nodes:
        node = nodes.pop()
        for child in node.get("children", []):
            assert (np.array(child["bound"]["min"]) >= node["bound"]["min"]).all()
            assert (np.array(child["bound"]["max"]) <= node["bound"]["max"]).all()
            nodes.append(child)


def test_every_level_is_what_was_written(town):
    for level, scene in enumerate(levels_of()):
        found = concatenated(list(read_level(town, level)), columns=True)
        assert found.count == scene.count and found.sh_degree == 1
        distances, _ = cKDTree(scene.means).query(found.means)
        assert distances.max() < 0.001


def test_it_is_read_as_its_finest_level(town):
    assert read_scene(town).count == read_scene(town.parent).count == 6000
    assert (
        describe(town)["bytes"]
        == size_on_disk(town.parent)
        == sum(file.stat().st_size for file in town.parent.rglob("*") if file.is_file())
    )
    assert split_name(town)[0] == "town"
    with pytest.raises(FormatError, match="level 3"):
        list(read_level(town, 3))


def test_an_older_one_is_replaced_with_its_files(town):
    (town.parent / "mine.txt").write_text("kept")
    write_levels(town, levels_of(1500, 0)[:2])
    assert read_scene(town).count == 1500
    meta = json.loads(town.read_text())
    folders = {file.name for file in town.parent.iterdir() if file.is_dir()}
    assert folders == {name.split("/")[0] for name in meta["filenames"]}
    assert (town.parent / "mine.txt").exists()


@pytest.mark.parametrize("named", ["link/meta.json", "portrait/meta.json", "0_9/meta.json"])
def test_an_older_one_names_what_is_not_its_own(town, tmp_path, named):
    """An index may name a folder behind a link, or another splat beside it: those files stay."""
    write_scene(tmp_path / "victim/meta.json", levels_of(100)[0])
    folder = town.parent / named.split("/")[0]
    if folder.name == "portrait":
        shutil.copytree(tmp_path / "victim", folder)
    else:
        folder.symlink_to(tmp_path / "victim")
    meta = json.loads(town.read_text())
    meta |= {"filenames": [*meta["filenames"], named], "environment": "portrait/meta.json"}
    town.write_text(json.dumps(meta))
    write_levels(town, levels_of(1500, 0)[:2])
    assert read_scene(town).count == 1500 and read_scene(folder / "meta.json").count == 100


def test_a_splat_in_a_folder_of_such_a_name_is_not_replaced(tmp_path):
    write_scene(tmp_path / "0_0/meta.json", levels_of(100)[0])
    write_levels(tmp_path / "lod-meta.json", levels_of(1500, 0)[:2])
    assert read_scene(tmp_path / "0_0/meta.json").count == 100
    assert read_scene(tmp_path / "lod-meta.json").count == 1500


def test_an_older_one_stays_until_the_new_one_is_complete(town, monkeypatch):
    def full(*_):
        raise SceneError("no space")

    with monkeypatch.context() as broken:
        broken.setattr(streamed_sog, "write_in_order", full)
        with pytest.raises(SceneError, match="no space"):
            write_levels(town, levels_of(1500))
    assert read_scene(town).count == 6000


def test_gaussians_in_one_place_end_in_one_leaf(tmp_path, monkeypatch):
    monkeypatch.setattr(streamed_sog, "CHUNK", 100)
    scene = like_trained(0, 500)
    scene.means[:400] = 1
    write_scene(tmp_path / "a" / "lod-meta.json", scene)
    assert read_scene(tmp_path / "a").count == 500


def test_units_with_fewer_bands_and_an_environment_are_joined(tmp_path):
    path = tmp_path / "a" / "lod-meta.json"
    write_scene(path, like_trained(2, 50))
    write_scene(path.parent / "env" / "meta.json", like_trained(0, 30))
    meta = json.loads(path.read_text())
    path.write_text(json.dumps(meta | {"environment": "env/meta.json"}))
    scene = read_scene(path)
    assert scene.count == 80 and scene.sh_degree == 2 and not scene.sh[50:, 1:].any()


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        ({"version": 2}, "version 1"),
        ({"lodLevels": 0}, "lodLevels"),
        ({"lodLevels": True}, "lodLevels"),
        ({"filenames": ["../b/meta.json"]}, "not in folders beside it"),
        ({"filenames": ["/b/meta.json"]}, "not in folders beside it"),
        ({"filenames": "0_0/meta.json"}, "not in folders beside it"),
        ({"environment": "a/../../b/meta.json"}, "not in folders beside it"),
        ({"tree": []}, "tree"),
        ({"tree": {"children": 3}}, "tree"),
        ({"tree": {"lods": {"0": {"file": 700, "offset": 0, "count": 1}}}}, "names no file"),
        ({"tree": {"lods": {"0": {"file": 0, "offset": 0, "count": 10**9}}}}, "1000000000 Gaussians"),
        ({"tree": {}}, "no file of level 0"),
    ],
)
def test_a_damaged_one_is_one_sentence(town, changed, said):
    town.write_text(json.dumps(json.loads(town.read_text()) | changed))
    with pytest.raises(FormatError, match=said) as caught:
        read_scene(town)
    assert "lod-meta.json" in str(caught.value) and "\n" not in str(caught.value)


def test_a_missing_unit_is_named(town):
    (town.parent / "0_0" / "meta.json").unlink()
    with pytest.raises(FormatError, match="0_0"):
        read_scene(town)


def test_a_streamed_sog_of_one_level_equals_the_sog(tmp_path):
    scene = like_trained(1, 400)
    write_scene(tmp_path / "a.sog", scene)
    write_scene(tmp_path / "b" / "lod-meta.json", scene)
    one, other = read_scene(tmp_path / "a.sog"), read_scene(tmp_path / "b")
    assert all(
        (getattr(one, name) == getattr(other, name)).all() for name in ("means", "log_scales", "quats", "sh")
    )
    assert dataclasses.asdict(one).keys() == dataclasses.asdict(other).keys()
    assert sog.degree_of(tmp_path / "b" / "0_0" / "meta.json") == 1
