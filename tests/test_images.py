"""Images come out as RGB in training colour space, whatever file they come from."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest

from svrgs_addon.files.images import (
    MAX_SIDE,
    image_size,
    library_path,
    linear_to_srgb,
    read_alpha,
    read_image,
    read_pixels,
    srgb_to_linear,
    write_image,
)
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_bench import scenes

oiio = pytest.importorskip("OpenImageIO")

RGB = np.random.default_rng(0).integers(0, 256, (6, 9, 3), dtype=np.uint8)
BIG = np.random.default_rng(0).integers(0, 40, (300, 400, 3), dtype=np.uint8)


def store(path, pixels, **attributes):
    """Write pixels as they are; `__` in an attribute's name stands for ':'."""
    pixels = np.ascontiguousarray(pixels)
    kind = {"uint8": "uint8", "uint16": "uint16", "float32": "float"}[str(pixels.dtype)]
    spec = oiio.ImageSpec(pixels.shape[1], pixels.shape[0], pixels.shape[2], kind)
    for name, value in attributes.items():
        spec.attribute(name.replace("__", ":"), value)
    output = oiio.ImageOutput.create(str(path))
    assert output.open(str(path), spec) and output.write_image(pixels) and output.close(), output.geterror()
    return path


@pytest.mark.parametrize("suffix", ["png", "tif"])
def test_8_bit_pixels_come_out_as_stored(tmp_path, suffix):
    path = store(tmp_path / f"a.{suffix}", RGB)
    assert np.array_equal(read_pixels(path), RGB)
    image = read_image(path)
    assert image.dtype == np.float32 and np.array_equal(image, RGB / np.float32(255))
    assert image_size(path) == (9, 6)


@pytest.mark.parametrize(
    "layers, picture",
    [
        (["ViewLayer.AO", "ViewLayer.Combined"], 1),
        (["Image", "Depth.V"], 0),
        (["Depth.V", "Image"], 1),
        (["Depth.V", "left"], 1),
        (["left", "right"], None),
    ],
)
def test_the_picture_of_an_exr_of_several_layers_is_read(tmp_path, layers, picture):
    names = [
        n for layer in layers for n in ([layer] if "." in layer[-2:] else [f"{layer}.{c}" for c in "RGBA"])
    ]
    values = [100.0 if name.endswith(".A") else float(k) for k, name in enumerate(names)]
    spec = oiio.ImageSpec(2, 2, len(names), "half")
    spec.channelnames = names
    output = oiio.ImageOutput.create(str(tmp_path / "a.exr"))
    output.open(str(tmp_path / "a.exr"), spec)
    output.write_image(np.tile(np.float32(values) / 100, (2, 2, 1)))
    output.close()
    if picture is None:
        with pytest.raises(FormatError, match="has the layers left, right; export one picture"):
            read_pixels(tmp_path / "a.exr")
        return
    first = names.index(f"{layers[picture]}.R")
    expected = linear_to_srgb(np.float32([first, first + 1, first + 2]) / 100)
    np.testing.assert_allclose(read_pixels(tmp_path / "a.exr")[0, 0], expected, atol=2e-3)
    assert read_alpha(tmp_path / "a.exr").min() == 1


@pytest.mark.parametrize("suffix", ["jpg", "webp"])
def test_lossy_formats(tmp_path, suffix):
    smooth = np.linspace(40, 200, 64 * 48).reshape(48, 64, 1).repeat(3, axis=2).astype(np.uint8)
    image = read_pixels(store(tmp_path / f"a.{suffix}", smooth, CompressionQuality=95))
    assert image.dtype == np.uint8 and np.abs(image.astype(int) - smooth).max() <= 6


def test_16_bit_and_float_keep_their_precision(tmp_path):
    deep = np.arange(27, dtype=np.uint16).reshape(3, 3, 3) + 30_000
    assert np.allclose(read_image(store(tmp_path / "a.png", deep)), deep / 65535, atol=1e-7, rtol=0)
    real = (deep / 65535).astype(np.float32)
    assert np.array_equal(read_image(store(tmp_path / "a.tif", real)), real)


def test_grey_becomes_rgb(tmp_path):
    image = read_pixels(store(tmp_path / "a.png", RGB[:, :, :1]))
    assert np.array_equal(image, RGB[:, :, :1].repeat(3, axis=2))


def test_exr_is_scene_linear(tmp_path):
    image = read_image(store(tmp_path / "a.exr", np.full((2, 2, 3), [0.0, 0.5, 4.0], np.float32)))
    assert np.allclose(image[0, 0], [0, 0.735357, 1], atol=1e-5)


@pytest.mark.parametrize("suffix, tolerance", [("png", 0.002), ("tif", 0.002), ("webp", 0.01)])
def test_alpha_is_composited_over_the_background(tmp_path, suffix, tolerance):
    rgba = np.full((8, 8, 4), [200, 100, 50, 128], np.uint8)
    rgba[:4, :, 3] = 0
    path = store(tmp_path / f"a.{suffix}", rgba, oiio__UnassociatedAlpha=1)
    image = read_image(path, background=(0, 1, 0.5))
    assert np.allclose(image[0, 0], [0, 1, 0.5], atol=tolerance)
    expected = np.array([200, 100, 50]) / 255 * 128 / 255 + np.array([0, 1, 0.5]) * (127 / 255)
    assert np.allclose(image[7, 7], expected, atol=tolerance)


def test_exr_alpha_is_associated(tmp_path):
    half = np.full((2, 2, 4), [0.25, 0.25, 0.25, 0.5], np.float32)  # linear 0.5 under half coverage
    image = read_image(store(tmp_path / "a.exr", half), background=(1, 1, 1))
    assert np.allclose(image, 0.735357 / 2 + 0.5, atol=1e-5)


def test_exif_orientation_is_ignored_as_colmap_does(tmp_path):
    path = store(tmp_path / "a.tif", RGB, Orientation=6)
    assert np.array_equal(read_pixels(path), RGB) and image_size(path) == (9, 6)


def test_png_rounds_and_clips(tmp_path):
    values = np.array([[-1, 0.4 / 255, 0.6 / 255, 0.5, 2]], np.float32)
    write_image(tmp_path / "a.png", values)
    assert read_pixels(tmp_path / "a.png")[0, :, 0].tolist() == [0, 0, 1, 128, 255]


@pytest.mark.parametrize("suffix, tolerance", [("png", 0.5 / 255), ("exr", 1e-6)])
def test_pictures_read_back_as_written(tmp_path, suffix, tolerance):
    colour = np.random.default_rng(1).random((5, 4, 3), np.float32)
    write_image(tmp_path / f"a.{suffix}", colour)
    assert np.allclose(read_image(tmp_path / f"a.{suffix}"), colour, atol=tolerance * 1.01, rtol=0)


def test_exr_data_keeps_its_numbers(tmp_path):
    depth = np.array([[0.5, 1234.5, -3.0]], np.float64)
    write_image(tmp_path / "a.exr", depth)
    source = oiio.ImageInput.open(str(tmp_path / "a.exr"))
    assert np.array_equal(source.read_image(oiio.FLOAT)[:, :, 0], depth)


def test_transfer_functions_are_inverse():
    values = np.linspace(-0.5, 2, 1001, dtype=np.float32)
    assert np.allclose(linear_to_srgb(srgb_to_linear(values)), values, atol=2e-6)


def test_unknown_suffix_is_refused(tmp_path):
    with pytest.raises(SceneError, match=r"a\.jpg.*\.png or \.exr"):
        write_image(tmp_path / "a.jpg", RGB)


def test_failed_write_leaves_the_old_picture(tmp_path, monkeypatch):
    path = tmp_path / "a.png"
    write_image(path, RGB)
    monkeypatch.setattr(oiio, "geterror", lambda: "disk full")
    monkeypatch.setattr(oiio.ImageOutput, "create", lambda _: None)
    with pytest.raises(SceneError, match="disk full"):
        write_image(path, 255 - RGB)
    assert list(tmp_path.iterdir()) == [path] and np.array_equal(read_pixels(path), RGB)


def test_broken_files_give_one_sentence(tmp_path):
    big = np.random.default_rng(0).integers(0, 256, (200, 200, 3), dtype=np.uint8)
    whole = {
        suffix: store(tmp_path / f"whole.{suffix}", big).read_bytes()
        for suffix in ("jpg", "png", "tif", "exr")
    }
    cases = {f"cut.{suffix}": data[: len(data) // 2] for suffix, data in whole.items()}
    cases |= {"text.png": b"hello", "empty.jpg": b""}
    for name, data in cases.items():
        (tmp_path / name).write_bytes(data)
        with pytest.raises(FormatError, match=name) as caught:
            read_image(tmp_path / name)
        assert "\n" not in str(caught.value)
    with pytest.raises(FormatError, match=r"none\.png"):
        image_size(tmp_path / "none.png")


@pytest.mark.parametrize("compression", ["none", "lzw", "packbits", "zip"])
@pytest.mark.parametrize("share", [0.6, 0.95])
def test_a_truncated_tiff_is_refused(tmp_path, compression, share):
    """OpenImageIO returns its first rows, and says only afterwards that the others are missing."""
    data = store(tmp_path / "whole.tif", BIG, compression=compression).read_bytes()
    (tmp_path / "cut.tif").write_bytes(data[: int(share * len(data))])
    with pytest.raises(FormatError, match="cut.tif: cannot be read as an image"):
        read_pixels(tmp_path / "cut.tif")


def test_a_tiff_with_changed_bytes_is_refused(tmp_path):
    data = bytearray(store(tmp_path / "a.tif", BIG, compression="lzw").read_bytes())
    data[len(data) // 2 : len(data) // 2 + 50] = bytes(
        byte ^ 0x5A for byte in data[len(data) // 2 : len(data) // 2 + 50]
    )
    (tmp_path / "a.tif").write_bytes(data)
    with pytest.raises(FormatError, match="a.tif: cannot be read as an image"):
        read_pixels(tmp_path / "a.tif")


def test_pixels_that_are_not_numbers_are_refused(tmp_path):
    path = store(tmp_path / "a.exr", np.full((2, 2, 3), np.nan, np.float32))
    with pytest.raises(FormatError, match="not numbers"):
        read_image(path)


def test_openimageio_gets_bytes_only_for_paths_that_are_not_utf_8():
    """That of Blender 5.2 takes no bytes."""
    assert library_path(Path("folder/größe.png")) == "folder/größe.png"
    assert library_path(os.fsdecode(b"folder/\xff.png")) == b"folder/\xff.png"


# --- what is an image at all


@pytest.mark.parametrize("suffix", ["bmp", "ppm", "tif", "png"])
def test_further_formats_are_read(tmp_path, suffix):
    assert np.array_equal(read_pixels(store(tmp_path / f"a.{suffix}", RGB)), RGB)


def test_hdr_is_scene_linear(tmp_path):
    image = read_image(store(tmp_path / "a.hdr", np.full((2, 2, 3), [0.0, 0.5, 4.0], np.float32)))
    assert np.allclose(image[0, 0], [0, 0.735357, 1], atol=1e-2)


OLDER = "needs OpenImageIO 3.0.7 or later, and this Python has"


def test_an_openimageio_that_changes_colours_under_alpha_in_webp_is_refused(tmp_path, monkeypatch):
    opaque = store(tmp_path / "opaque.webp", RGB, compression="lossless")
    clear = store(tmp_path / "clear.webp", np.dstack([RGB, RGB[:, :, 0]]), compression="lossless")
    assert read_pixels(clear).shape == RGB.shape
    monkeypatch.setattr(oiio, "VERSION", 3_00_06)
    assert np.array_equal(read_pixels(opaque), RGB)
    with pytest.raises(FormatError, match=f"clear.webp: cannot be read, because WebP with alpha {OLDER}"):
        read_pixels(clear)


@pytest.mark.parametrize("name", ["toy.sog", "toy/meta.json", "toy/lod-meta.json"])
def test_with_such_an_openimageio_no_sog_is_written_or_read(tmp_path, monkeypatch, name):
    path, scene = tmp_path / name, scenes.room(50)
    write_scene(path, scene)
    old = path.read_bytes()
    monkeypatch.setattr(oiio, "VERSION", 3_00_06)
    with pytest.raises(FormatError, match=f"toy.* cannot be read, because WebP with alpha {OLDER}"):
        read_scene(path)
    with pytest.raises(SceneError, match=f"{name}: cannot be written, because WebP with alpha {OLDER}"):
        write_scene(path, scene)
    assert path.read_bytes() == old


@pytest.mark.parametrize("name", ["zeros.png", "zeros.jpg", "text.tif"])
def test_files_that_begin_like_no_image_are_not_given_to_a_reader(tmp_path, monkeypatch, name):
    """A reader of OpenImageIO looks through zeros to the end, at 60 ms a megabyte."""
    (tmp_path / name).write_bytes(bytes(10_000) if "zeros" in name else b"no image" * 100)
    monkeypatch.setattr(oiio.ImageInput, "open", lambda *_: pytest.fail("the file was given to OpenImageIO"))
    with pytest.raises(FormatError, match=f"{name}: cannot be read as an image .it begins like no JPEG, PNG"):
        image_size(tmp_path / name)


def test_a_damaged_image_is_given_only_to_the_reader_of_its_kind(tmp_path, monkeypatch):
    (tmp_path / "a.jpg").write_bytes(b"\xff\xd8\xff\xe0" + bytes(1000))
    # the suffix of another kind: every reader may try
    store(tmp_path / "b.png", RGB).rename(tmp_path / "b.jpg")
    asked, open_ = [], oiio.ImageInput.open
    monkeypatch.setattr(
        oiio.ImageInput,
        "open",
        lambda *words: (asked.append(oiio.get_int_attribute("try_all_readers")), open_(*words))[1],
    )
    with pytest.raises(FormatError, match="a.jpg: cannot be read as an image"):
        read_pixels(tmp_path / "a.jpg")
    assert np.array_equal(read_pixels(tmp_path / "b.jpg"), RGB)
    assert asked == [0, 1] and oiio.get_int_attribute("try_all_readers") == 1


def test_a_large_file_with_the_suffix_of_another_kind_is_refused(tmp_path):
    with open(tmp_path / "a.png", "wb") as file:
        file.write(b"\xff\xd8\xff\xe0")
        file.truncate(100 * 2**20)
    with pytest.raises(
        FormatError,
        match="a.png: cannot be read as an image .it begins like a JPEG file.; give its name the suffix .jpg",
    ):
        image_size(tmp_path / "a.png")


def test_what_is_no_file_is_not_opened(tmp_path):
    os.mkfifo(tmp_path / "a.png")
    with pytest.raises(FormatError, match="a.png: is not a file"):
        image_size(tmp_path / "a.png")


@pytest.mark.parametrize("shape", [(1, MAX_SIDE + 1, 3), (MAX_SIDE + 1, 1, 3)])
def test_a_picture_with_a_side_that_is_too_long_is_refused(tmp_path, shape):
    write_image(tmp_path / "a.png", np.zeros(shape, np.uint8))
    with pytest.raises(FormatError, match="the limit is 16384 per side"):
        read_pixels(tmp_path / "a.png")
