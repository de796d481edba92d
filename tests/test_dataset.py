"""COLMAP datasets: forms of folder, scaled photographs, camera models, memory, and reading ahead."""

from __future__ import annotations

import itertools
import os
import shutil
import struct
import sys
import threading

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

from row_dataset import HEIGHT, OPENCV, POINTS, WIDTH, make_dataset, only_the_three_files, photo
from svrgs_addon.files.images import write_image
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.views import dataset as dataset_module
from svrgs_addon.views.dataset import load_dataset

# --- what is read


@pytest.mark.parametrize("text", [False, True])
def test_points_may_name_keypoints_that_no_image_has(tmp_path, text):
    """As in models of converters. Their tracks are not needed."""
    make_dataset(tmp_path, text=text)
    path = tmp_path / "sparse/0" / ("points3D.txt" if text else "points3D.bin")
    if text:
        lines = path.read_text().splitlines()
        path.write_text("\n".join(line if line.startswith("#") else f"{line} 1 99 77 0" for line in lines))
    else:
        data = path.read_bytes()
        records = [data[8 + 51 * i : 8 + 51 * i + 43] for i in range(len(POINTS))]
        path.write_bytes(
            data[:8] + b"".join(record + struct.pack("<QIIII", 2, 1, 99, 77, 0) for record in records)
        )
    data = load_dataset(tmp_path)
    assert np.allclose(data.points, POINTS) and data.point_colors.tolist() == [[10, 20, 30]] * 3
    assert len(data.cameras) == 9


@pytest.mark.parametrize("text", [False, True])
@pytest.mark.parametrize("legacy", [False, True])
def test_cameras_points_and_split(tmp_path, text, legacy):
    reconstruction = make_dataset(tmp_path, text=text)
    if legacy:
        only_the_three_files(tmp_path / "sparse/0")
    data = load_dataset(tmp_path)
    assert [camera.name for camera in data.cameras] == [f"{i:02}.png" for i in range(9)]
    assert (data.test_indices, data.train_indices) == ([0, 8], [1, 2, 3, 4, 5, 6, 7])
    assert np.allclose(data.points, POINTS) and data.points.dtype == np.float32
    assert data.point_colors.tolist() == [[10, 20, 30]] * 3 and data.point_colors.dtype == np.uint8
    for index, camera in enumerate(data.cameras):
        image = reconstruction.find_image_with_name(camera.name)
        assert np.allclose(camera.viewmat[:3], image.cam_from_world().matrix(), atol=1e-12)
        assert np.allclose(camera.K, [[60, 0, 30.5], [0, 58, 25], [0, 0, 1]])
        assert np.array_equal(data.image(index), photo(index))


def test_extent_is_that_of_the_training_cameras(tmp_path):
    make_dataset(tmp_path)
    data = load_dataset(tmp_path, holdout=0)
    assert not data.test_indices and len(data.train_indices) == 9
    centres = np.array([camera.position for camera in data.cameras])
    assert np.isclose(data.extent, 1.1 * np.linalg.norm(centres - centres.mean(0), axis=1).max())
    assert load_dataset(tmp_path).extent < data.extent


@pytest.mark.parametrize(
    "below, given",
    [
        ("sparse/0", ""),
        ("sparse/0", "sparse"),
        ("sparse/0", "sparse/0"),
        ("sparse", ""),
        ("sparse", "sparse"),
        (".", ""),
        ("model", "model"),
    ],
)
def test_forms_of_folder(tmp_path, below, given):
    make_dataset(tmp_path, below=below)
    assert np.array_equal(load_dataset(tmp_path / given).image(3), photo(3))


def test_folder_given_relative_to_the_working_directory(tmp_path, monkeypatch):
    make_dataset(tmp_path)
    monkeypatch.chdir(tmp_path / "sparse")
    assert len(load_dataset(".").cameras) == len(load_dataset("0").cameras) == 9


def test_photographs_in_subfolders(tmp_path):
    make_dataset(tmp_path, ["left/a.png", "left/b.png", "right/a.png"])
    data = load_dataset(tmp_path)
    assert [camera.name for camera in data.cameras] == ["left/a.png", "left/b.png", "right/a.png"]
    assert np.array_equal(data.image(2), photo(2))


def test_real_dataset(shared_data):
    data = load_dataset(shared_data / "brighton_beach")
    assert (len(data.cameras), len(data.points), data.image(0).shape) == (18, 4179, (450, 800, 3))


def test_rigs_and_frames_are_not_looked_at(tmp_path):
    make_dataset(tmp_path)
    for name in ("rigs", "frames"):
        (tmp_path / "sparse/0" / f"{name}.bin").write_bytes(b"\xff" * 100)
    assert len(load_dataset(tmp_path, cameras_only=True).cameras) == 9


@pytest.mark.parametrize("text", [False, True])
def test_image_names_may_hold_spaces_and_other_bytes(tmp_path, text):
    """COLMAP writes names as they are: in a text file, the name is the rest of the line."""
    names = ["a b.png", "left eye/c  d.png", "λ 1.png", "trailing .png"]
    make_dataset(tmp_path, names, text=text)
    data = load_dataset(tmp_path)
    assert [camera.name for camera in data.cameras] == sorted(names) and not data.notes
    assert all(
        np.array_equal(data.image(k), photo(names.index(name))) for k, name in enumerate(sorted(names))
    )


@pytest.mark.skipif(sys.platform != "linux", reason="names of files are bytes on Linux only")
@pytest.mark.parametrize("text", [False, True])
def test_image_names_need_not_be_utf_8(tmp_path, text):
    make_dataset(tmp_path, ["caf_.png"], text=text)
    path = tmp_path / "sparse/0" / ("images.txt" if text else "images.bin")
    path.write_bytes(path.read_bytes().replace(b"caf_", b"caf\xe9"))
    (tmp_path / "images/caf_.png").rename(tmp_path / "images" / os.fsdecode(b"caf\xe9.png"))
    data = load_dataset(tmp_path)
    assert data.cameras[0].name == os.fsdecode(b"caf\xe9.png") and np.array_equal(data.image(0), photo(0))


def test_another_number_than_0_is_found(tmp_path):
    make_dataset(tmp_path, below="sparse/1")
    assert len(load_dataset(tmp_path).cameras) == 9
    shutil.copytree(tmp_path / "sparse/1", tmp_path / "sparse/2")
    with pytest.raises(
        FormatError, match=r"holds several models, but no sparse/0; name one of .*sparse/1, .*sparse/2"
    ):
        load_dataset(tmp_path)
    assert len(load_dataset(tmp_path / "sparse/2").cameras) == 9


# --- links, as SECURITY.md describes them


@pytest.mark.parametrize("linked", ["photograph", "folder"])
def test_links_in_the_image_folder_are_followed(tmp_path, linked):
    make_dataset(tmp_path / "a")
    place = tmp_path / "a/images" / ("" if linked == "folder" else "00.png")
    place.rename(tmp_path / "elsewhere")
    place.symlink_to(tmp_path / "elsewhere")
    assert np.array_equal(load_dataset(tmp_path / "a").image(0), photo(0))


def test_a_link_to_anything_but_a_file_is_not_opened(tmp_path):
    """A pipe would be waited for, and the device has no end."""
    make_dataset(tmp_path)
    os.mkfifo(tmp_path / "pipe")
    for name, target in (("00.png", tmp_path / "pipe"), ("01.png", "/dev/zero")):
        (tmp_path / "images" / name).unlink()
        (tmp_path / "images" / name).symlink_to(target)
    assert "2 of 9 photographs are missing: 00.png, 01.png" in load_dataset(tmp_path).notes[0]


# --- missing photographs


def test_missing_photographs_are_left_out_and_named(tmp_path, caplog):
    """The others stay test or training views: pictures that were held out before are never trained on."""
    make_dataset(tmp_path)
    for name in ("00.png", "03.png", "04.png", "07.png"):
        (tmp_path / "images" / name).unlink()
    data = load_dataset(tmp_path)
    assert [camera.name for camera in data.cameras] == ["01.png", "02.png", "05.png", "06.png", "08.png"]
    assert (data.test_indices, data.train_indices) == ([4], [0, 1, 2, 3])
    assert [np.array_equal(data.image(k), photo(i)) for k, i in enumerate((1, 2, 5, 6, 8))] == [True] * 5
    sentence = (
        f"{tmp_path}/images: 4 of 9 photographs are missing: 00.png, 03.png, 04.png, ...; the other 5 are"
        " used"
    )
    assert data.notes == (sentence,) and caplog.messages == [sentence]
    centres = np.array([data.cameras[k].position for k in data.train_indices])
    assert np.isclose(data.extent, 1.1 * np.linalg.norm(centres - centres.mean(0), axis=1).max())


def test_control_characters_of_names_are_not_repeated(tmp_path):
    make_dataset(tmp_path, ["a.png", "b\x1b[31m.png"])
    (tmp_path / "images/b\x1b[31m.png").unlink()
    assert r"missing: b\x1b[31m.png;" in load_dataset(tmp_path).notes[0]


def test_nothing_is_noted_where_nothing_is_missing(tmp_path, caplog):
    make_dataset(tmp_path)
    assert load_dataset(tmp_path).notes == () and not caplog.messages


# --- scaled photographs


@pytest.mark.parametrize("size", [(32, 24), (21, 16), (22, 16), (128, 96)])
def test_intrinsics_follow_the_size_of_the_photograph(tmp_path, size):
    make_dataset(tmp_path, images="images_2", size=size)
    camera = load_dataset(tmp_path, "images_2").cameras[0]
    assert (camera.width, camera.height) == size
    x, y = size[0] / WIDTH, size[1] / HEIGHT
    assert np.allclose(camera.K, [[60 * x, 0, 30.5 * x], [0, 58 * y, 25 * y], [0, 0, 1]])


def test_image_folder_elsewhere(tmp_path):
    make_dataset(tmp_path / "scene")
    (tmp_path / "scene" / "images").rename(tmp_path / "photos")
    assert np.array_equal(load_dataset(tmp_path / "scene", str(tmp_path / "photos")).image(1), photo(1))


@pytest.mark.parametrize("size", [(48, 64), (32, 27), (64, 52)])
def test_other_aspect_ratio_is_refused(tmp_path, size):
    make_dataset(tmp_path, size=size)
    with pytest.raises(
        SceneError, match=r"00\.png: the photograph is .* no scaled copy of its camera's 64 x 48"
    ):
        load_dataset(tmp_path)


# --- distorted cameras


def spot_image(centre: np.ndarray, width: int, height: int) -> np.ndarray:
    """A smooth bright spot at `centre` (pixels, pixel centres at k + 0.5)."""
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    spot = np.exp(-((x - centre[0]) ** 2 + (y - centre[1]) ** 2) / (2 * 3.0**2))
    return np.rint(255 * spot).astype(np.uint8)[..., None].repeat(3, axis=2)


def centroid(image: np.ndarray) -> np.ndarray:
    weights = image[..., 0].astype(float)
    x, y = np.meshgrid(np.arange(image.shape[1]) + 0.5, np.arange(image.shape[0]) + 0.5)
    return np.array([(weights * x).sum(), (weights * y).sum()]) / weights.sum()


@pytest.mark.parametrize(
    "model",
    [
        OPENCV,
        ("OPENCV_FISHEYE", [60.0, 58.0, 31.0, 25.0, 0.05, -0.01, 0.0, 0.0]),
        ("SIMPLE_RADIAL", [60, 32, 24, -0.15]),
    ],
)
@pytest.mark.parametrize("scale", [1, 4])
def test_distorted_photographs_are_undistorted(tmp_path, model, scale):
    size = (WIDTH * scale, HEIGHT * scale)
    reconstruction = make_dataset(tmp_path, ["a.png"], model, size=size)
    image = reconstruction.find_image_with_name("a.png")
    for point in POINTS:
        feature = image.project_point(point) * scale  # where COLMAP sees it in the distorted photograph
        write_image(tmp_path / "images/a.png", spot_image(feature, *size))
        data = load_dataset(tmp_path)
        camera = data.cameras[0]
        x, y, z = camera.K @ (camera.viewmat[:3, :3] @ point + camera.viewmat[:3, 3])
        assert data.image(0).shape == (camera.height, camera.width, 3)
        assert np.linalg.norm(centroid(data.image(0)) - np.array([x, y]) / z) < 0.1


def test_panorama_is_refused(tmp_path):
    make_dataset(tmp_path, ["a.png"], ("EQUIRECTANGULAR", [WIDTH, HEIGHT]))
    with pytest.raises(SceneError, match=r"a\.png: its camera model is EQUIRECTANGULAR"):
        load_dataset(tmp_path)


# --- cameras without photographs


def test_cameras_only(tmp_path):
    make_dataset(tmp_path, model=OPENCV)
    full = load_dataset(tmp_path)
    shutil.rmtree(tmp_path / "images")
    data = load_dataset(tmp_path, cameras_only=True)
    assert np.array_equal(data.cameras[3].K, full.cameras[3].K)
    with pytest.raises(SceneError, match="without its photographs"):
        data.image(0)


# --- memory and reading ahead


def test_images_stay_in_memory_within_the_budget(tmp_path, monkeypatch):
    make_dataset(tmp_path)
    reads = []
    read_pixels = dataset_module.read_pixels
    monkeypatch.setattr(
        dataset_module,
        "read_pixels",
        lambda path, *a, **k: reads.append(path.name) or read_pixels(path, *a, **k),
    )
    data = load_dataset(tmp_path, memory_budget=3 * WIDTH * HEIGHT * 3)
    for _ in range(2):
        for index in range(4):
            assert np.array_equal(data.image(index), photo(index))
    assert reads == ["00.png", "01.png", "02.png", "03.png", "03.png"]


@pytest.mark.parametrize("memory_budget", [0, 2**30])
def test_stream_follows_its_order(tmp_path, memory_budget):
    make_dataset(tmp_path)
    data = load_dataset(tmp_path, memory_budget=memory_budget)
    order = [5, 1, 1, 8, 0, 3, 5]
    got = list(data.stream(order))
    assert [index for index, _ in got] == order
    assert all(np.array_equal(image, photo(index)) for index, image in got)
    assert not list(data.stream([]))


def test_stream_may_be_endless_and_ends_its_threads(tmp_path):
    make_dataset(tmp_path)
    before = threading.active_count()
    stream = load_dataset(tmp_path).stream(itertools.cycle([2, 4]))
    assert [index for index, _ in itertools.islice(stream, 5)] == [2, 4, 2, 4, 2]
    stream.close()
    assert threading.active_count() == before


def test_stream_reports_a_broken_photograph(tmp_path):
    make_dataset(tmp_path)
    data = load_dataset(tmp_path)
    (tmp_path / "images/02.png").write_bytes(b"no image any more")
    with pytest.raises(FormatError, match=r"02\.png"):
        list(data.stream([0, 1, 2, 3]))


def test_images_are_read_only(tmp_path):
    make_dataset(tmp_path)
    with pytest.raises(ValueError, match="read-only"):
        load_dataset(tmp_path).image(0)[0] = 0
