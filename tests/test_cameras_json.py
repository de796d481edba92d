"""cameras.json of a 3DGS run: its conventions, and entries that are refused."""

from __future__ import annotations

import json
import os
import sys

import numpy as np
import pytest

from svrgs_addon.scene.camera import Camera
from svrgs_addon.system.errors import FormatError
from svrgs_addon.views.cameras_json import load_cameras_json, write_cameras_json
from svrgs_addon.views.dataset import load_dataset
from system_checks import with_pipes

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")


def test_cameras_json_of_a_3dgs_run(shared_data):
    scene = shared_data / "snowmiku_plush"
    cameras = load_cameras_json(scene / "upstream_3dgs" / "cameras.json")
    others = {camera.name.split(".")[0]: camera for camera in load_dataset(scene, cameras_only=True).cameras}
    assert len(cameras) == 97
    distances = [np.linalg.norm(camera.position - others[camera.name].position) for camera in cameras]
    turns = [np.trace(camera.viewmat[:3, :3] @ others[camera.name].viewmat[:3, :3].T) for camera in cameras]
    assert max(distances) < 0.05 and min(turns) > 1 + 2 * np.cos(np.radians(0.6))


GOOD_ENTRY = {
    "id": 0, "img_name": "a", "width": 64, "height": 48, "position": [1, 2, 3],
    "rotation": [[0, -1, 0], [1, 0, 0], [0, 0, 1]], "fy": 58.0, "fx": 60.0,
}  # fmt: skip


def test_cameras_json_conventions(tmp_path):
    (tmp_path / "cameras.json").write_text(json.dumps([GOOD_ENTRY]))
    (camera,) = load_cameras_json(tmp_path / "cameras.json")
    assert np.allclose(camera.position, [1, 2, 3])
    # camera x is the rotation's first column
    assert np.allclose(camera.viewmat[:3, :3] @ [0, 1, 0], [1, 0, 0])
    assert np.allclose(camera.K, [[60, 0, 32], [0, 58, 24], [0, 0, 1]]) and not camera.orthographic
    (tmp_path / "cameras.json").write_text(json.dumps([GOOD_ENTRY | {"orthographic": True}]))
    assert load_cameras_json(tmp_path / "cameras.json")[0].orthographic
    (tmp_path / "cameras.json").write_text(json.dumps([GOOD_ENTRY | {"orthographic": 1}]))
    with pytest.raises(FormatError, match="orthographic is 1; true or false is expected"):
        load_cameras_json(tmp_path / "cameras.json")


@pytest.mark.parametrize("width, good", [(64.0, True), (64.5, False)])
def test_whole_numbers_may_be_written_with_a_point(tmp_path, width, good):
    (tmp_path / "cameras.json").write_text(json.dumps([GOOD_ENTRY | {"width": width}]))
    if good:
        assert load_cameras_json(tmp_path / "cameras.json")[0].width == 64
        return
    with pytest.raises(FormatError, match="an image side is 64.5"):
        load_cameras_json(tmp_path / "cameras.json")


def test_what_is_written_is_read_again(tmp_path):
    K = np.array([[60.0, 0, 30.5], [0, 58, 24], [0, 0, 1]])
    cameras = [Camera(np.eye(4), K, 64, 48, "a"), Camera(np.eye(4), K, 61, 48, "b", True)]
    write_cameras_json(tmp_path / "cameras.json", cameras)
    for before, after in zip(cameras, load_cameras_json(tmp_path / "cameras.json"), strict=True):
        assert (after.K == K).all() and (after.viewmat == np.eye(4)).all()
        assert (after.name, after.width) == (before.name, before.width)
        assert after.orthographic == before.orthographic
    assert [("cx" in entry) for entry in json.loads((tmp_path / "cameras.json").read_text())] == [True, False]


# of a file, but for Windows
NO_NAME = pytest.param(
    "img_name", "a\ud800", marks=pytest.mark.skipif(sys.platform == "win32", reason="a name there")
)


@pytest.mark.parametrize(
    "key, value",
    [
        ("img_name", "../a"), ("img_name", "a\0"), NO_NAME, ("width", 0), ("width", 10**6),
        ("height", 48.5), ("fx", -1), ("fx", None),
        ("fy", float("nan")), ("position", [1, 2]), ("position", [1, 2, float("inf")]),
        ("position", [10**400, 0, 0]), ("position", [1e38, 0, 0]), ("fx", 1e30),
        ("rotation", [[1, 0, 0]] * 3), ("rotation", [[1, 0], [0, 1]]),
        ("rotation", [[1, 0, 0], [0, 1, 0], [0, 0, -1]]),
    ],
)  # fmt: skip
def test_unusable_cameras_json_entries(tmp_path, key, value):
    (tmp_path / "cameras.json").write_text(json.dumps([GOOD_ENTRY, GOOD_ENTRY | {key: value}]))
    with pytest.raises(FormatError, match=r"cameras\.json: camera 1 is not usable"):
        load_cameras_json(tmp_path / "cameras.json")
    (tmp_path / "cameras.json").write_text(json.dumps([{k: v for k, v in GOOD_ENTRY.items() if k != key}]))
    with pytest.raises(FormatError, match=f"lacks '{key}'"):
        load_cameras_json(tmp_path / "cameras.json")


@with_pipes
def test_only_regular_files_are_read(tmp_path):
    """A pipe would be waited for, and the device has no end."""
    os.mkfifo(tmp_path / "pipe")
    for path in (tmp_path / "pipe", "/dev/zero", tmp_path):
        with pytest.raises(FormatError, match="a pipe, a device or a folder"):
            load_cameras_json(path)


@pytest.mark.parametrize("text", ["", "{}", "[]", "[1]", "[" * 100_000, "\xff"])
def test_other_json(tmp_path, text):
    (tmp_path / "cameras.json").write_text(text, encoding="latin-1")
    with pytest.raises(FormatError, match=r"cameras\.json"):
        load_cameras_json(tmp_path / "cameras.json")
