"""COLMAP datasets that do not fit are refused with clear words."""

from __future__ import annotations

import struct

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from row_dataset import OPENCV, make_dataset, make_model, only_the_three_files
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.views.dataset import load_dataset


def test_photographs_are_refused_if_fewer_than_a_third_are_there(tmp_path):
    make_dataset(tmp_path)
    for i in range(6):
        (tmp_path / f"images/{i:02}.png").unlink()
    assert len(load_dataset(tmp_path).cameras) == 3
    (tmp_path / "images/06.png").unlink()
    with pytest.raises(
        SceneError,
        match=(
            r"images: 7 of 9 photographs are missing: 00\.png, 01\.png, 02\.png, \.\.\.; at least a third"
            r" must be there: give"
        ),
    ):
        load_dataset(tmp_path)


def test_missing_folders(tmp_path):
    with pytest.raises(SceneError, match="no COLMAP model"):
        load_dataset(tmp_path)
    with pytest.raises(SceneError, match="no COLMAP model"):
        load_dataset(tmp_path / "nowhere")
    make_dataset(tmp_path)
    with pytest.raises(SceneError, match="no image folder images_8"):
        load_dataset(tmp_path, "images_8")


def test_no_views_and_no_points(tmp_path):
    make_dataset(tmp_path, points=[])
    assert load_dataset(tmp_path).points.shape == (0, 3)
    with pytest.raises(SceneError, match="no 3-D points"):
        load_dataset(tmp_path, need_points=True)
    make_model([]).write_binary(tmp_path / "sparse/0")
    with pytest.raises(SceneError, match="no view"):
        load_dataset(tmp_path)


@pytest.mark.parametrize("text", [False, True])
def test_two_images_of_one_name_are_refused(tmp_path, text):
    make_dataset(tmp_path, ["a.png", "b.png", "c.png"], text=text)
    path = tmp_path / "sparse/0" / ("images.txt" if text else "images.bin")
    path.write_bytes(path.read_bytes().replace(b"c.png", b"a.png"))
    with pytest.raises(FormatError, match="names the photograph 'a.png' twice"):
        load_dataset(tmp_path)


def test_images_without_lines_of_keypoints_are_refused(tmp_path):
    """Else every second photograph would be taken for keypoints."""
    make_dataset(tmp_path, ["a.png", "b.png", "c.png"], text=True)
    path = tmp_path / "sparse/0/images.txt"
    images = [line for line in path.read_text().splitlines() if line.endswith(".png")]
    path.write_text("\n".join(images) + "\n")
    with pytest.raises(FormatError, match="no line of keypoints after each image"):
        load_dataset(tmp_path)


def test_spaces_after_the_name_of_an_image_do_not_count(tmp_path):
    make_dataset(tmp_path, ["a.png", "b.png"], text=True)
    path = tmp_path / "sparse/0/images.txt"
    path.write_text(path.read_text().replace(".png", ".png "))
    assert [camera.name for camera in load_dataset(tmp_path).cameras] == ["a.png", "b.png"]


@pytest.mark.parametrize("name", ["../a.png", "/etc/a.png", "b/../../a.png", "C:\\a.png", "..\\a.png"])
def test_image_names_cannot_leave_the_folder(tmp_path, name):
    make_model([name]).write_binary(tmp_path)
    with pytest.raises(FormatError, match="does not stay inside"):
        load_dataset(tmp_path, cameras_only=True)


@pytest.mark.parametrize("params", [[0.0, 58, 30, 25], [float("nan"), 58, 30, 25], [60, -58, 30, 25]])
def test_unusable_cameras_are_refused(tmp_path, params):
    make_model(["a.png"], ("PINHOLE", params)).write_binary(tmp_path)
    with pytest.raises(SceneError, match="not usable"):
        load_dataset(tmp_path, cameras_only=True)


def test_cameras_of_absurd_size_are_refused(tmp_path):
    make_dataset(tmp_path, model=OPENCV)
    path = tmp_path / "sparse/0/cameras.bin"
    data = path.read_bytes()
    path.write_bytes(data[:16] + struct.pack("<Q", 2**50) + data[24:])
    with pytest.raises(FormatError, match="the limit is 16384 per side"):
        load_dataset(tmp_path, cameras_only=True)


def test_points_far_out_are_refused(tmp_path):
    make_dataset(tmp_path, points=[[1e39, 0, 0]])
    with pytest.raises(FormatError, match="finite place"):
        load_dataset(tmp_path, cameras_only=True)


@pytest.mark.parametrize("name", ["cameras", "images", "points3D"])
def test_truncated_binary_models(tmp_path, name):
    make_dataset(tmp_path)
    only_the_three_files(tmp_path / "sparse/0")
    path = tmp_path / "sparse/0" / f"{name}.bin"
    data = path.read_bytes()
    for size in range(len(data)):
        path.write_bytes(data[:size])
        with pytest.raises(FormatError, match=f"{name}.bin is incomplete"):
            load_dataset(tmp_path, cameras_only=True)
    path.write_bytes(struct.pack("<Q", 2**60) + data[8:])
    with pytest.raises(FormatError, match="incomplete"):
        load_dataset(tmp_path, cameras_only=True)


@pytest.mark.parametrize(
    "name, old, new",
    [
        ("cameras", "PINHOLE", "HOLE"),
        ("images", "01.png", ""),
        ("points3D", "10 20 30", "x"),
        ("cameras", "64", "nan"),
    ],
)
def test_broken_text_models(tmp_path, name, old, new):
    make_dataset(tmp_path, text=True)
    only_the_three_files(tmp_path / "sparse/0")
    path = tmp_path / "sparse/0" / f"{name}.txt"
    path.write_text(path.read_text().replace(old, new))
    with pytest.raises(FormatError) as caught:
        load_dataset(tmp_path, cameras_only=True)
    assert "\n" not in str(caught.value)


def stretch_a_rotation(folder, text: bool, factor: float):
    """Multiplies the quaternion of the first image in the file."""
    path = folder / ("images.txt" if text else "images.bin")
    if not text:
        data = path.read_bytes()
        quaternion = np.frombuffer(data, "<f8", 4, offset=12) * factor
        path.write_bytes(data[:12] + quaternion.tobytes() + data[44:])
        return
    lines = path.read_text().splitlines()
    row = next(i for i, line in enumerate(lines) if line and not line.startswith("#"))
    words = lines[row].split()
    words[1:5] = (repr(float(word) * factor) for word in words[1:5])
    lines[row] = " ".join(words)
    path.write_text("\n".join(lines))


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("factor", [2.0, 0.0, float("nan")])
def test_rotations_that_are_no_unit_quaternions_are_refused(tmp_path, text, factor):
    make_dataset(tmp_path, text=text)
    stretch_a_rotation(tmp_path / "sparse/0", text, factor)
    with pytest.raises(FormatError, match=r"sparse/0: the rotation of '\d\d.png' is a quaternion of length"):
        load_dataset(tmp_path, cameras_only=True)


@pytest.mark.parametrize("text", [False, True])
def test_rotations_are_read_that_are_rounded(tmp_path, text):
    make_dataset(tmp_path, text=text)
    stretch_a_rotation(tmp_path / "sparse/0", text, 1 + 1e-6)
    assert len(load_dataset(tmp_path, cameras_only=True).cameras) == 9
