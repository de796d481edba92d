"""transforms.json: the same dataset as from COLMAP, its conventions, and files that are refused."""

from __future__ import annotations

import json
import math
import shutil
import sys

import numpy as np
import pytest

pytest.importorskip("pycolmap")
pytest.importorskip("OpenImageIO")

import scenes
from row_dataset import HEIGHT, OPENCV, PINHOLE, POINTS, WIDTH, make_dataset, photo
from svrgs_addon.files.ply_points import read_points
from svrgs_addon.system import packages
from svrgs_addon.system.errors import FormatError, SceneError
from svrgs_addon.views.colmap import read_model
from svrgs_addon.views.dataset import Dataset, load_dataset
from svrgs_addon.views.transforms_json import read_transforms
from transforms_dataset import transforms_of, write_points, write_transforms

FILE = "transforms.json"
FISHEYE = ("OPENCV_FISHEYE", [60.0, 58.0, 31.0, 25.0, 0.05, -0.01, 0.002, -0.001])


def both(folder, model=PINHOLE, size=(WIDTH, HEIGHT)) -> tuple[Dataset, dict]:
    """The dataset as COLMAP has it, and the contents of transforms.json, which then stands alone in the
    folder."""
    make_dataset(folder, model=model, size=size)
    facts, colmap = write_transforms(folder, read_model(folder / "sparse/0")), load_dataset(folder)
    for image in range(len(colmap.cameras)):
        colmap.image(image)  # cached
    shutil.rmtree(folder / "sparse")
    return colmap, facts


def rewrite(folder, facts: dict, **changes):
    (folder / "transforms.json").write_text(json.dumps(facts | changes))


@pytest.mark.parametrize("model", [PINHOLE, OPENCV, FISHEYE], ids=lambda model: model[0])
@pytest.mark.parametrize("scale", [1, 2])
def test_the_same_dataset_as_from_colmap(tmp_path, model, scale, caplog):
    colmap, _ = both(tmp_path, model, (scale * WIDTH, scale * HEIGHT))
    data = load_dataset(tmp_path)
    assert (data.train_indices, data.test_indices) == (colmap.train_indices, colmap.test_indices)
    for index, (a, b) in enumerate(zip(data.cameras, colmap.cameras, strict=True)):
        assert (a.name, a.width, a.height) == (b.name, b.width, b.height)
        assert np.abs(a.viewmat - b.viewmat).max() < 1e-9 and np.abs(a.K - b.K).max() < 1e-9
        assert np.array_equal(data.image(index), colmap.image(index))
    assert np.array_equal(data.points, colmap.points)
    assert np.array_equal(data.point_colors, colmap.point_colors)
    assert data.notes == (f"the cameras are those of {tmp_path / FILE}",)
    assert caplog.messages[-1:] == list(data.notes)


def test_a_colmap_model_goes_first_and_it_is_said(tmp_path):
    make_dataset(tmp_path)
    write_transforms(tmp_path, read_model(tmp_path / "sparse/0"))
    assert load_dataset(tmp_path).notes == (
        f"the cameras are those of {tmp_path / 'sparse/0'}, not those of {tmp_path / FILE}",
    )
    assert load_dataset(tmp_path / "transforms.json").notes == (
        f"the cameras are those of {tmp_path / FILE}",
    )


def test_intrinsics_of_the_file_and_of_a_frame(tmp_path):
    _, facts = both(tmp_path)
    frames = [{key: frame[key] for key in ("file_path", "transform_matrix")} for frame in facts["frames"]]
    frames[0]["fl_x"] = 70.0
    rewrite(tmp_path, facts, frames=frames, w=float(WIDTH), h=HEIGHT, fl_x=60.0, fl_y=58.0)
    *others, last = load_dataset(tmp_path, cameras_only=True).cameras
    assert all(
        np.array_equal(camera.K, [[60, 0, WIDTH / 2], [0, 58, HEIGHT / 2], [0, 0, 1]]) for camera in others
    )
    assert last.K[0, 0] == 70


def test_an_angle_of_view_and_the_size_of_the_photographs_are_enough(tmp_path):
    """As in files that Blender's exporters write; names without extension, too."""
    _, facts = both(tmp_path)
    frames = [
        {"file_path": frame["file_path"].removesuffix(".png"), "transform_matrix": frame["transform_matrix"]}
        for frame in facts["frames"]
    ]
    rewrite(tmp_path, {"frames": frames, "camera_angle_x": 2 * math.atan(0.5)})
    data = load_dataset(tmp_path)
    assert np.allclose(data.cameras[3].K, [[WIDTH, 0, WIDTH / 2], [0, WIDTH, HEIGHT / 2], [0, 0, 1]])
    assert data.cameras[3].name == "03" and np.array_equal(data.image(3), photo(3))
    assert data.points.shape == (0, 3)


def test_other_image_folders(tmp_path):
    both(tmp_path)
    (tmp_path / "images").rename(tmp_path / "images_2")
    with pytest.raises(SceneError, match="images: 9 of 9 photographs are missing: 00.png"):
        load_dataset(tmp_path)
    assert np.array_equal(load_dataset(tmp_path, "images_2").image(4), photo(4))


def test_photographs_of_several_folders_and_with_backslashes(tmp_path):
    _, facts = both(tmp_path)
    (tmp_path / "left").mkdir()
    (tmp_path / "images/00.png").rename(tmp_path / "left/00.png")
    facts["frames"][-1]["file_path"] = "left\\00.png"
    rewrite(tmp_path, facts)
    data = load_dataset(tmp_path)
    assert [camera.name for camera in data.cameras][7:] == ["images/08.png", "left/00.png"]
    assert np.array_equal(data.image(8), photo(0))


def test_a_third_radial_coefficient(tmp_path):
    """OpenCV's k3 is r⁶ in the numerator; what the pinhole then shows is what the full model of COLMAP
    shows."""
    _, facts = both(tmp_path, OPENCV)
    rewrite(tmp_path, facts, frames=[frame | {"k3": 0.05} for frame in facts["frames"]])
    assert load_dataset(tmp_path).photos[0].distorted.model_name == "FULL_OPENCV"
    rewrite(tmp_path, facts, frames=[frame | {"k4": 0.05} for frame in facts["frames"]])
    with pytest.raises(
        FormatError, match=r"k4 = 0.05, which is not supported; export photographs without distortion"
    ):
        load_dataset(tmp_path)


def test_the_world_of_a_splat_of_nerfstudio(tmp_path):
    """dataparser_transforms.json leads from the world before applied_transform to that of the trained
    splat."""
    colmap, facts = both(tmp_path)
    applied, turn = np.eye(4)[[0, 2, 1, 3]] * [1, 1, -1, 1], np.eye(4)
    turn[:3, :3], turn[:3, 3] = scenes.CAMERAS["rotated"].viewmat[:3, :3], (1, 2, 3)
    rewrite(tmp_path, facts, applied_transform=applied[:3].tolist(), applied_scale=2.0)
    parser = {"transform": (turn @ applied)[:3].tolist(), "scale": 2.0 * 0.25}
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(parser))
    data = load_dataset(tmp_path)
    world = 0.25 * (POINTS @ turn[:3, :3].T + turn[:3, 3])
    assert np.allclose(data.points, world, atol=1e-6) and "moved into the world of the splat" in data.notes[1]
    for a, b in zip(data.cameras, colmap.cameras, strict=True):
        seen = POINTS @ b.viewmat[:3, :3].T + b.viewmat[:3, 3]
        assert np.allclose(world @ a.viewmat[:3, :3].T + a.viewmat[:3, 3], 0.25 * seen)
        assert np.allclose(a.K, b.K)


def test_what_is_not_used_is_said(tmp_path):
    _, facts = both(tmp_path)
    rewrite(
        tmp_path,
        facts,
        frames=[frame | {"mask_path": "masks/a.png"} for frame in facts["frames"]],
        ply_file_path="gone.ply",
    )
    assert load_dataset(tmp_path).notes[1:] == (
        f"{tmp_path / 'gone.ply'}: the sparse points that transforms.json names are missing",
        f"the dataset names {len(facts['frames'])} masks that are missing; all pixels of their photographs"
        " count",
    )
    with pytest.raises(SceneError, match=r"transforms.json: has no 3-D points"):
        load_dataset(tmp_path, need_points=True)


# --- refused


MATRIX = np.eye(4).tolist()
FRAMES = {  # what is changed in one frame -> the reason
    "no photograph": ({"file_path": None}, "its file_path is no text"),
    "outside": ({"file_path": "../00.png"}, "does not stay inside"),
    "absolute": ({"file_path": "/etc/passwd"}, "does not stay inside"),
    "windows": ({"file_path": "C:\\a.png"}, "does not stay inside"),
    "nan": ({"transform_matrix": [[math.nan] * 4] * 4}, "finite numbers"),
    "far": ({"transform_matrix": [[1e300] * 4] * 4}, "finite numbers"),
    "beyond": ({"transform_matrix": [[10**400] * 4] * 4}, "too large"),
    "ragged": ({"transform_matrix": [[1, 2], [3]]}, "inhomogeneous"),
    "short": ({"transform_matrix": [1, 2, 3]}, "4 x 4"),
    "stretched": ({"transform_matrix": np.diag([2.0, 2, 2, 1]).tolist()}, "does not hold a rotation"),
    "mirrored": ({"transform_matrix": np.diag([-1.0, 1, 1, 1]).tolist()}, "does not hold a rotation"),
    "perspective": ({"transform_matrix": [*MATRIX[:3], [0, 0, 1, 1]]}, "4 x 4"),
    "focal": ({"fl_x": 0}, "focal length"),
    "focal nan": ({"fl_x": math.nan}, "fl_x is nan"),
    "focal text": ({"fl_x": "60"}, "fl_x is 60; a finite number"),
    "focal true": ({"fl_y": True}, "fl_y is True"),
    "huge": ({"w": 2**20}, "its size is"),
    "half": ({"w": 63.5}, "its size is 63.5 x 48"),
    "distortion": ({"k1": math.inf}, "k1 is inf"),
    "panorama": (
        {"camera_model": "EQUIRECTANGULAR"},
        "'EQUIRECTANGULAR'; export photographs without distortion",
    ),
    "model": ({"camera_model": ["x"]}, "camera_model"),
}


@pytest.mark.parametrize("name", FRAMES)
def test_frames_that_are_not_usable(tmp_path, name):
    changes, reason = FRAMES[name]
    _, facts = both(tmp_path)
    facts["frames"][3] |= changes
    rewrite(tmp_path, facts)
    with pytest.raises(
        FormatError, match=r"transforms.json: (frame 3|05\.png) is not usable \(.*" + reason
    ) as caught:
        load_dataset(tmp_path)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize("key", ["file_path", "transform_matrix"])
def test_frames_that_lack_a_key(tmp_path, key):
    _, facts = both(tmp_path)
    del facts["frames"][3][key]
    rewrite(tmp_path, facts)
    with pytest.raises(FormatError, match=f"is not usable \\(lacks '{key}'\\)"):
        load_dataset(tmp_path)


def test_frames_without_focal_length_or_size(tmp_path):
    _, facts = both(tmp_path)
    frames = facts["frames"]
    rewrite(
        tmp_path,
        facts,
        frames=[{k: v for k, v in frame.items() if k not in ("fl_x", "fl_y")} for frame in frames],
    )
    with pytest.raises(FormatError, match="neither fl_x nor camera_angle_x"):
        load_dataset(tmp_path)
    rewrite(tmp_path, facts, frames=[{k: v for k, v in frame.items() if k != "w"} for frame in frames])
    (tmp_path / "images/05.png").unlink()
    found = load_dataset(tmp_path)
    assert len(found.cameras) == len(frames) - 1
    assert "nothing says the size of a photograph: 05.png" in "".join(found.notes)


def test_a_list_of_distortion_is_that_of_nerfstudio(tmp_path):
    _, facts = both(tmp_path)
    frames = facts["frames"]
    for where in ({"distortion_params": [0.1, 0.02, 0, 0, 0.001, 0.002]}, {}):
        each = [frame | {"distortion_params": [0.1, 0.02, 0, 0, 0.001, 0.002]} for frame in frames]
        rewrite(tmp_path, facts, **({"frames": frames} | where if where else {"frames": each}))
        model = read_transforms(tmp_path / "transforms.json").model
        assert model.views[0].camera.model == "OPENCV"
        assert model.views[0].camera.params[4:] == (0.1, 0.02, 0.001, 0.002)
    rewrite(tmp_path, facts, frames=[frame | {"distortion_params": [0.1]} for frame in frames])
    with pytest.raises(FormatError, match="not the six numbers k1, k2, k3, k4, p1, p2"):
        read_transforms(tmp_path / "transforms.json")


def test_a_photograph_that_is_named_twice(tmp_path):
    _, facts = both(tmp_path)
    facts["frames"].append(facts["frames"][2])
    rewrite(tmp_path, facts)
    with pytest.raises(FormatError, match="names the photograph '06.png' twice"):
        load_dataset(tmp_path)


@pytest.mark.parametrize(
    "text", ["", "[]", "{}", '{"frames": []}', '{"frames": 3}', '{"frames": [3]}', "[" * 100_000, "\xff"]
)
def test_other_json(tmp_path, text):
    both(tmp_path)
    (tmp_path / "transforms.json").write_text(text, encoding="latin-1")
    with pytest.raises(FormatError, match=r"transforms\.json"):
        load_dataset(tmp_path)


@pytest.mark.parametrize(
    "parser",
    [
        {},
        {"transform": MATRIX, "scale": 0},
        {"transform": np.diag([2.0, 1, 1, 1]).tolist(), "scale": 1},
        {"scale": 1},
    ],
)
def test_unusable_parser_transforms(tmp_path, parser):
    both(tmp_path)
    (tmp_path / "dataparser_transforms.json").write_text(json.dumps(parser))
    with pytest.raises(FormatError, match=r"dataparser_transforms.json: it is not usable"):
        load_dataset(tmp_path)


# --- sparse points


@pytest.mark.parametrize("kind", ["<f4", "<f8", ">f4"])
def test_points_in_binary(tmp_path, kind):
    order = "little" if kind[0] == "<" else "big"
    row = np.dtype([("x", kind), ("y", kind), ("z", kind), ("red", "u1"), ("green", "u1"), ("blue", "u1")])
    rows = np.array([(*point, 1, 2, 3) for point in POINTS], row)
    names = {"f4": "float", "f8": "double", "u1": "uchar"}
    header = [f"ply\nformat binary_{order}_endian 1.0\nelement vertex {len(rows)}"]
    header += [f"property {names[row[name].str[1:]]} {name}" for name in row.names]
    (tmp_path / "p.ply").write_bytes("\n".join([*header, "end_header", ""]).encode() + rows.tobytes())
    points, colors = read_points(tmp_path / "p.ply")
    assert np.allclose(points, POINTS) and points.dtype == np.float32 and colors.tolist() == [[1, 2, 3]] * 3
    (tmp_path / "p.ply").write_bytes((tmp_path / "p.ply").read_bytes()[:-1])
    with pytest.raises(FormatError, match="p.ply is incomplete: it holds fewer than the 3 points"):
        read_points(tmp_path / "p.ply")


@pytest.mark.parametrize(
    "damage",
    [
        ("vertex 3", "vertex 4"),
        ("vertex 3", "vertex 99999999"),
        ("property float x", "property float w"),
        ("0.6", "1e39"),
        ("0.6", "six"),
    ],
)
def test_damaged_points(tmp_path, damage):
    write_points(tmp_path / "p.ply", POINTS, np.full((3, 3), 9))
    (tmp_path / "p.ply").write_text((tmp_path / "p.ply").read_text().replace(*damage))
    with pytest.raises(FormatError, match="p.ply "):
        read_points(tmp_path / "p.ply")


def test_colours_as_floats_and_no_colours(tmp_path):
    write_points(tmp_path / "p.ply", POINTS, np.array([[0, 1, 0]] * 3))
    text = (tmp_path / "p.ply").read_text()
    (tmp_path / "p.ply").write_text(text.replace("property uint8", "property float"))
    assert read_points(tmp_path / "p.ply")[1].tolist() == [[0, 255, 0]] * 3
    (tmp_path / "p.ply").write_text(text.replace("blue", "hue"))
    assert read_points(tmp_path / "p.ply")[1].tolist() == [[128] * 3] * 3


# --- other programs


@pytest.mark.parametrize(
    "name, text, words",
    [
        (
            "cameras.xml",
            '<?xml version="1.0"?>\n<document version="2.0.0">\n <chunk label="Chunk 1">',
            "cameras of Metashape are not read.*Export Cameras.*Colmap",
        ),
        ("job.psx", "<document/>", "cameras of Metashape"),
        (
            "scan.rcproj",
            "<RealityCaptureProject/>",
            "cameras of RealityScan are not read.*Alignment > Registration",
        ),
        (
            "scan.csv",
            "#name,x,y,alt,heading,pitch,roll,f,px,py,k1,k2,k3,k4,t1,t2\n",
            "cameras of RealityScan",
        ),
        ("list.csv", "a,b\n", "holds no COLMAP model .*, and no transforms.json"),
        ("page.xml", "<html/>", "holds no COLMAP model"),
    ],
)
def test_cameras_of_other_programs(tmp_path, name, text, words):
    (tmp_path / name).write_text(text)
    with pytest.raises(SceneError, match=words):
        load_dataset(tmp_path)


# --- commands


def test_commands_take_it_like_colmap(tiny, svrgs, tmp_path):
    shutil.copytree(tiny.folder / "images", tmp_path / "images")
    (tmp_path / "run").mkdir()
    splat = shutil.copy(tiny.splat, tmp_path / "run/scene.ply")
    write_transforms(tmp_path, read_model(tiny.folder / "sparse/0"))
    a, b = (
        svrgs("eval", tiny.splat, "--colmap", folder, "--json").json for folder in (tiny.folder, tmp_path)
    )
    assert a["psnr"] == pytest.approx(b["psnr"], abs=1e-6)
    assert b["notes"] == [f"the cameras are those of {tmp_path / FILE}"]
    words = ("--method", "opacity", "--target", 0.5, "--recovery", 3, "--quiet", "--json")
    assert svrgs("prune", splat, *words).json["count"] == 125, "the dataset is found above the splat"
    trained = svrgs(
        "train", "--colmap", tmp_path, "--iterations", 5, "--quiet", "--json", "--out", tmp_path / "t.ply"
    ).json
    assert trained["count"] == len(tiny.truth.means)
    words = "--colmap", tmp_path, "--views 0,1 --json --out", tmp_path / "out"
    assert len(svrgs("render", tiny.splat, *words).json["files"]) == 2


def test_the_real_dataset_as_transforms(shared_data, tmp_path):
    model = read_model(shared_data / "brighton_beach/sparse/0")
    (tmp_path / "transforms.json").write_text(json.dumps(transforms_of(model)))
    shutil.copytree(shared_data / "brighton_beach/images", tmp_path / "images")
    a, b = load_dataset(shared_data / "brighton_beach"), load_dataset(tmp_path)
    assert max(np.abs(x.viewmat - y.viewmat).max() for x, y in zip(a.cameras, b.cameras, strict=True)) < 1e-9
    assert np.array_equal(a.image(7), b.image(7))


def test_pinhole_cameras_need_no_pycolmap(tmp_path, monkeypatch):
    """A Blender whose Python pycolmap does not support reads transforms.json all the same, and says what it
    cannot do."""
    make_dataset(tmp_path / "a"), make_dataset(tmp_path / "b", model=OPENCV)
    for folder in (tmp_path / "a", tmp_path / "b"):
        write_transforms(folder, read_model(folder / "sparse/0"))
    expected = load_dataset(tmp_path / "a")
    monkeypatch.setitem(sys.modules, "pycolmap", None)
    data = load_dataset(tmp_path / "a/transforms.json")
    assert np.array_equal(data.image(0), expected.image(0))
    assert np.abs(data.cameras[0].K - expected.cameras[0].K).max() < 1e-9
    needed = (
        "^reading a COLMAP model, unlike a transforms.json, needs the package pycolmap: run .* -m pip install"
    )
    with pytest.raises(SceneError, match=needed):
        load_dataset(tmp_path / "a")
    lack = "Python 3.12 lacks pycolmap: do this"
    monkeypatch.setenv(packages.MISSING_VARIABLE, lack)
    with pytest.raises(SceneError, match=f"^undistorting photographs needs the package pycolmap: {lack}$"):
        load_dataset(tmp_path / "b/transforms.json").image(0)
