"""A damaged or hostile SOG: one sentence that names it, soon, and nothing outside of its folder is read."""

from __future__ import annotations

import io
import json
import zipfile
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.cli.batch_list import expand
from svrgs_addon.files import images, sog, sog_layout
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.system.errors import FormatError
from test_formats import by_gaussforge, like_trained


@pytest.fixture
def folder(tmp_path) -> Path:
    """The files of a SOG of 100 Gaussians, SH degree 1."""
    write_scene(tmp_path / "a.ply", like_trained(1, 100))
    with zipfile.ZipFile(
        io.BytesIO(by_gaussforge((tmp_path / "a.ply").read_bytes(), ".ply", ".sog"))
    ) as bundle:
        bundle.extractall(tmp_path / "sog")
    assert read_scene(tmp_path / "sog").count == 100
    return tmp_path / "sog"


def change(folder: Path, changed):
    meta = json.loads((folder / "meta.json").read_text())
    changed(meta)
    (folder / "meta.json").write_text(json.dumps(meta))


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda meta: meta.update(version=3), "version 3"),
        (lambda meta: meta.pop("version"), "version unknown"),
        (lambda meta: meta.update(count=10**9), "more than the limit"),
        (lambda meta: meta.update(count=True), "number of Gaussians"),
        (lambda meta: meta.update(count=60_000), "pixels for 60,000"),
        (lambda meta: meta.pop("quats"), "no quats"),
        (lambda meta: meta["means"].update(mins=[0, 0]), "mins of 3 numbers"),
        (lambda meta: meta["means"].update(maxs=[0, 0, float("nan")]), "maxs of 3 numbers"),
        (lambda meta: meta["scales"].update(codebook=[0.0] * 255), "codebook of 256"),
        (lambda meta: meta["sh0"].update(files=["../a.ply"]), "names no texture"),
        (lambda meta: meta["sh0"].update(files=["/etc/x.webp"]), "names no texture"),
        (lambda meta: meta["sh0"].update(files=["gone.webp"]), "gone.webp is missing"),
        (lambda meta: meta["shN"].update(bands=4), "SH bands"),
        (lambda meta: meta["shN"].update(bands=2), "palette"),
    ],
)
def test_meta_json_that_does_not_fit(folder, changed, said):
    change(folder, changed)
    with pytest.raises(FormatError, match=said) as caught:
        read_scene(folder)
    assert "meta.json" in str(caught.value) and "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "text",
    ["", "[1]", "{", "[" * 100_000, '{"a": 1' + " " * 1_000_000 + "}"],
    ids=["empty", "list", "cut", "deep", "large"],
)
def test_meta_json_that_is_none(folder, text):
    (folder / "meta.json").write_text(text)
    with pytest.raises(FormatError, match="that can be read"):
        read_scene(folder)


def test_a_damaged_texture_is_named(folder):
    (folder / "quats.webp").write_bytes((folder / "quats.webp").read_bytes()[:40])
    with pytest.raises(FormatError, match=r"its texture quats\.webp"):
        read_scene(folder)


def test_a_texture_that_is_larger_than_its_file_needs_is_refused(folder, monkeypatch):
    monkeypatch.setattr(sog, "MANY", 16)
    large = np.zeros((64, 64, 3), np.uint8)
    images.write_texture(folder / "scales.webp", folder / "scales.webp", large)
    with pytest.raises(FormatError, match="has 64 x 64 pixels, more than its file needs"):
        read_scene(folder)


def test_a_rotation_whose_largest_component_is_none_turns_nothing(folder):
    quats = images.read_texture(folder / "quats.webp", 1 << 20)
    quats[0, 1, 3] = 7
    images.write_texture(folder / "quats.webp", folder / "quats.webp", quats)
    found = read_scene(folder).quats
    assert found[1].tolist() == [1, 0, 0, 0] and (found[0] != found[1]).any()


def test_a_bundle_reads_as_its_folder_does_and_leaves_nothing_behind(folder, tmp_path, monkeypatch):
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path / "temporary"))
    (tmp_path / "temporary").mkdir()
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as bundle:
        for file in folder.iterdir():
            bundle.write(file, file.name)
        bundle.writestr("../../out.webp", b"x")
        bundle.writestr("below/in.webp", b"x")
    assert (read_scene(tmp_path / "b.sog").means == read_scene(folder).means).all()
    assert not list((tmp_path / "temporary").iterdir()) and not (tmp_path / "out.webp").exists()


def test_a_bundle_that_unpacks_to_much_is_refused(folder, tmp_path):
    with zipfile.ZipFile(tmp_path / "b.sog", "w", zipfile.ZIP_DEFLATED) as bundle:
        for file in folder.iterdir():
            bundle.write(file, file.name)
        bundle.writestr("sh0.webp", bytes(50_000_000))
    with pytest.raises(FormatError, match="sh0.webp that is larger than it can be"):
        read_scene(tmp_path / "b.sog")


def test_a_meta_json_that_is_too_large_is_not_unpacked(folder, tmp_path, monkeypatch):
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as bundle:
        bundle.write(folder / "meta.json", "meta.json")
    monkeypatch.setattr(sog_layout, "MAX_META", 10)
    monkeypatch.setattr(zipfile.ZipFile, "extract", lambda *_: pytest.fail("it was unpacked"))
    with pytest.raises(FormatError, match="has no meta.json"):
        read_scene(tmp_path / "b.sog")


def test_of_a_bundle_only_what_meta_json_names_is_unpacked(folder, tmp_path, monkeypatch):
    unpacked, extract = [], zipfile.ZipFile.extract
    with zipfile.ZipFile(tmp_path / "b.sog", "w") as bundle:
        for file in folder.iterdir():
            bundle.write(file, file.name)
        for number in range(1_000):
            bundle.writestr(f"{number}.webp", b"")
    monkeypatch.setattr(
        zipfile.ZipFile, "extract", lambda *words: (unpacked.append(words[1].filename), extract(*words))
    )
    assert read_scene(tmp_path / "b.sog").count == read_scene(folder).count
    assert sorted(unpacked) == sorted(file.name for file in folder.iterdir())


def test_a_bundle_with_a_damaged_member_is_refused(folder, tmp_path):
    with zipfile.ZipFile(tmp_path / "b.sog", "w", zipfile.ZIP_DEFLATED) as bundle:
        bundle.write(folder / "meta.json", "meta.json")
    data = bytearray((tmp_path / "b.sog").read_bytes())
    data[60:90] = b"\xff" * 30  # within the packed bytes
    (tmp_path / "b.sog").write_bytes(data)
    with pytest.raises(FormatError, match="no SOG, or damaged"):
        read_scene(tmp_path / "b.sog")


def test_meta_json_of_a_dataset_makes_no_splat_of_its_folder(folder, tmp_path):
    for file in folder.glob("*.webp"):
        file.unlink()
    (folder / "scene.ply").write_bytes((tmp_path / "a.ply").read_bytes())
    assert [item.scene.name for item in expand([folder], None, None)] == ["scene.ply"]


def test_what_is_no_bundle(tmp_path):
    (tmp_path / "b.sog").write_bytes(b"PK broken")
    with pytest.raises(FormatError, match="no SOG"):
        read_scene(tmp_path / "b.sog")
