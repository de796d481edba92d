"""A .glb: nodes that move splats, several splats, whole numbers for values; a splat that is packed as an SPZ;
what is damaged or hostile is one sentence."""

from __future__ import annotations

import dataclasses
import json
import struct

import numpy as np
import pytest

from svrgs_addon.files import glb
from svrgs_addon.files.axes import turned_around, turned_over
from svrgs_addon.files.glb_container import Glb, glb_of
from svrgs_addon.files.registry import read_scene, write_scene
from svrgs_addon.scene.affine import transformed
from svrgs_addon.system.errors import FormatError, SceneError, TooMany
from test_formats import differences, judged, like_trained, rotations

SPLAT, DRAFT = "KHR_gaussian_splatting", "KHR_gaussian_splatting_compression_spz_2"


@pytest.fixture
def path(tmp_path):
    write_scene(tmp_path / "a.glb", like_trained(1, 50))
    return tmp_path / "a.glb"


@pytest.fixture
def packed(tmp_path):
    write_scene(tmp_path / "a.spz.glb", like_trained(2, 50))
    return tmp_path / "a.spz.glb"


def test_more_bytes_than_the_header_can_say_are_refused():
    with pytest.raises(SceneError, match="a GLB has at most 4 GiB, and this one would have 4.7"):
        glb_of({}, [5_000_000_000])


def change(path, changed, data=None):
    """Writes the file again with other JSON, and other bytes if they are given."""
    with open(path, "rb") as file:
        glb = Glb.read(file)
    changed(glb.contents)
    text, data = json.dumps(glb.contents).encode(), glb.data if data is None else data
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(data), b"BIN\0") + data
    path.write_bytes(struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks)


def primitive(contents) -> dict:
    return contents["meshes"][0]["primitives"][0]


def test_y_is_up_in_the_file(path):
    with open(path, "rb") as file:
        glb = Glb.read(file)
    means = glb.values(primitive(glb.contents)["attributes"]["POSITION"], 3)
    assert (means == like_trained(1, 50).means * (1, -1, -1)).all()
    assert glb.contents["accessors"][0]["max"] == means.max(axis=0).tolist()
    assert glb.contents["extensionsUsed"] == [SPLAT]


def test_nodes_move_what_is_below_them(path):
    """A quarter turn around z that doubles, below a move; and the same splat as it is."""
    half = 0.5**0.5
    nodes = [
        {"translation": [1, 2, 3], "children": [1]},
        {"rotation": [0, 0, half, half], "scale": [2, 2, 2], "mesh": 0},
        {"mesh": 0, "matrix": np.eye(4).T.ravel().tolist()},
    ]
    change(path, lambda contents: contents.update(nodes=nodes, scenes=[{"nodes": [0, 2]}]))
    found, scene = read_scene(path), like_trained(1, 50)
    flip = np.diag([1.0, -1, -1, 1])
    matrix = np.array([[0.0, -2, 0, 1], [2, 0, 0, 2], [0, 0, 2, 3], [0, 0, 0, 1]])
    moved = transformed(scene, flip @ matrix @ flip)
    assert found.count == 100
    for part, expected in ((found.select(slice(0, 50)), scene), (found.select(slice(50, 100)), moved)):
        assert max(differences(part, expected).values()) < 1e-4


def test_splats_of_different_degree_are_joined(path):
    def changed(contents):
        other = json.loads(json.dumps(primitive(contents)))
        other["attributes"] = {
            name: number for name, number in other["attributes"].items() if "SH_DEGREE_1" not in name
        }
        contents["meshes"][0]["primitives"].append(other)

    change(path, changed)
    found = read_scene(path)
    assert found.count == 100 and found.sh_degree == 1 and (found.sh[:50, 1:] != 0).any()
    assert (found.sh[50:, 1:] == 0).all()


def test_normalised_whole_numbers_are_shares(path):
    with open(path, "rb") as file:
        glb = Glb.read(file)
    opacities = np.array([0, 128, 255] + [7] * 47, np.uint8)

    def changed(contents):
        contents["bufferViews"].append({"buffer": 0, "byteOffset": len(glb.data), "byteLength": 52})
        contents["accessors"].append(
            {
                "bufferView": len(contents["bufferViews"]) - 1,
                "componentType": 5121,
                "normalized": True,
                "count": 50,
                "type": "SCALAR",
            }
        )
        primitive(contents)["attributes"][f"{SPLAT}:OPACITY"] = len(contents["accessors"]) - 1

    change(path, changed, glb.data + opacities.tobytes() + b"\0\0")
    assert 1 / (1 + np.exp(-read_scene(path).opacity_logits)) == pytest.approx(opacities / 255, abs=1e-6)


@pytest.mark.parametrize(
    ("changed", "said"),
    [
        (lambda contents: primitive(contents).pop("extensions"), "holds no splat"),
        (
            lambda contents: primitive(contents)["extensions"][SPLAT].update(extensions={"KHR_packed": {}}),
            "packed by KHR_packed",
        ),
        (
            lambda contents: primitive(contents)["extensions"][SPLAT].update(extensions={"a\nb": {}}),
            r"packed by a\?b, which",
        ),
        (
            lambda contents: primitive(contents)["extensions"][SPLAT].update(colorSpace="lin_rec709_display"),
            "other colours",
        ),
        (lambda contents: primitive(contents)["attributes"].pop(f"{SPLAT}:SCALE"), "does not have"),
        (lambda contents: contents["accessors"][0].update(count=49), "another kind or length"),
        (lambda contents: contents["accessors"][0].update(count=10**9), "more elements"),
        (lambda contents: contents["accessors"][0].update(componentType=5125), "another kind"),
        (lambda contents: contents["accessors"][0].update(sparse={}), "another kind"),
        (lambda contents: contents["bufferViews"][0].update(byteOffset=10**6), "beyond its end"),
        (lambda contents: contents["bufferViews"][0].update(byteOffset=-4), "beyond its end"),
        (lambda contents: contents["bufferViews"][0].update(byteStride=4), "beyond its end"),
        (lambda contents: contents["nodes"][0].update(children=[0]), "below themselves"),
        (lambda contents: contents["nodes"][0].update(matrix=[1, 2]), "transform that is none"),
        (lambda contents: contents["nodes"][0].update(scale=[0, 0, 0]), "cannot be placed"),
        (lambda contents: contents["nodes"][0].update(rotation=[0, 0, 0, 0]), "cannot be placed"),
        (lambda contents: contents.update(nodes=3), "no list"),
        (lambda contents: contents["scenes"][0].update(nodes=3), "holds no splat"),
        (lambda contents: contents["nodes"][0].update(children=3, mesh=[0]), "does not have"),
        (lambda contents: contents["meshes"][0].update(primitives=3), "holds no splat"),
        (lambda contents: contents["accessors"][0].update(componentType=[5126]), "another kind"),
        (lambda contents: contents["accessors"][0].update(type=["VEC3"]), "another kind"),
        (lambda contents: contents.update(scene=7), "does not have"),
    ],
)
def test_what_does_not_fit_is_refused(path, changed, said):
    change(path, changed)
    with pytest.raises(FormatError, match=said) as caught:
        read_scene(path)
    assert str(caught.value).startswith(str(path))


@pytest.mark.parametrize("data", [b"", b"glTF", b"glTF" + bytes(40), b"PK\3\4" + bytes(40)])
def test_what_is_no_glb(path, data):
    path.write_bytes(data)
    with pytest.raises(FormatError, match="glTF|glb"):
        read_scene(path)


def test_it_is_cut_anywhere(path):
    data = path.read_bytes()
    for length in range(0, len(data) - 1, 97):
        path.write_bytes(data[:length])
        with pytest.raises(FormatError):
            read_scene(path)


def test_the_spz_inside_is_one_that_others_read_in_axes_of_its_own(packed, tmp_path):
    """Unpacked to the axes of glTF, it is the splat that .glb holds."""
    with open(packed, "rb") as file:
        glb = Glb.read(file)
    extension = primitive(glb.contents)["extensions"][SPLAT]
    assert glb.contents["extensionsRequired"] == [SPLAT, DRAFT] and extension["kernel"] == "ellipse"
    assert all(
        "bufferView" not in accessor and accessor["count"] == 50 for accessor in glb.contents["accessors"]
    )
    theirs = judged(glb.view(extension["extensions"][DRAFT]["bufferView"]), ".spz", tmp_path / "judged.ply")
    assert max(differences(turned_around(theirs), read_scene(packed)).values()) < 0.002


def test_a_packed_splat_of_the_first_drafts_keeps_the_axes_of_the_spz(packed):
    now = read_scene(packed)
    change(packed, lambda contents: primitive(contents)["extensions"][SPLAT].pop("kernel"))
    assert max(differences(read_scene(packed), turned_around(now)).values()) < 1e-6


def test_packed_splats_stand_beside_others_and_more_than_once(packed):
    scene = read_scene(packed)
    nodes = [{"mesh": 0}, {"mesh": 0, "translation": [5, 0, 0]}]
    change(packed, lambda contents: contents.update(nodes=nodes, scenes=[{"nodes": [0, 1]}]))
    found = read_scene(packed)
    assert found.count == 100 and sorted(found.means[:, 0].tolist()) == pytest.approx(
        sorted([*scene.means[:, 0], *(scene.means[:, 0] + 5)])
    )


@pytest.mark.parametrize(
    "turn, matrix", [(turned_over, np.diag([1.0, -1, -1, 1])), (turned_around, np.diag([-1.0, 1, -1, 1]))]
)
def test_half_a_turn_is_the_transform(turn, matrix):
    """Quaternions may differ by half turns around the axes of the ellipsoid, so covariances are compared."""
    scene = like_trained(3)
    ours, theirs = turn(scene), transformed(scene, matrix)
    found = differences(ours, theirs)
    covariances = [
        np.einsum("nij,nj,nkj->nik", rotations(one.quats), np.exp(2.0 * one.log_scales), rotations(one.quats))
        for one in (ours, theirs)
    ]
    assert np.abs(covariances[0] - covariances[1]).max() < 1e-5
    assert max(value for name, value in found.items() if name != "turn") < 1e-5


def extension_of(contents) -> dict:
    return primitive(contents)["extensions"][SPLAT]["extensions"][DRAFT]


@pytest.mark.parametrize(
    "changed, said",
    [
        (lambda contents: extension_of(contents).pop("bufferView"), "without its values"),
        (lambda contents: extension_of(contents).update(bufferView=[0]), "without its values"),
        (lambda contents: extension_of(contents).update(bufferView=7), "does not have"),
        (lambda contents: contents["bufferViews"][0].update(byteLength=10**6), "beyond its end"),
        (lambda contents: contents["bufferViews"][0].pop("byteLength"), "beyond its end"),
        (lambda contents: contents["bufferViews"][0].update(byteLength=100), "incomplete"),
        (lambda contents: contents["bufferViews"][0].update(byteOffset=1), "no SPZ"),
    ],
)
def test_a_packed_splat_that_does_not_fit_is_refused(packed, changed, said):
    # to have room
    change(
        packed,
        lambda contents: contents["bufferViews"][0].update(
            byteLength=contents["bufferViews"][0]["byteLength"] - 1
        ),
    )
    change(packed, changed)
    with pytest.raises(FormatError, match=said) as caught:
        read_scene(packed)
    assert str(caught.value).startswith(str(packed))


def test_splats_that_are_packed_in_the_same_bytes_are_refused(packed):
    """Each would be unpacked by itself."""

    def changed(contents):
        view, one = contents["bufferViews"][0], primitive(contents)
        again = json.loads(json.dumps(one))
        again["extensions"][SPLAT]["extensions"][DRAFT]["bufferView"] = 1
        contents.update(bufferViews=[view, view], meshes=[{"primitives": [one, again]}])

    change(packed, changed)
    with pytest.raises(FormatError, match="the same bytes"):
        read_scene(packed)


def test_too_many_are_refused_for_good_as_they_cannot_be_read_in_parts(path):
    with pytest.raises(
        FormatError,
        match=r"more than the limit of 3; this kind of file cannot be read in parts: save it as PLY or SPZ",
    ) as refused:
        next(glb.read_parts(path, 3))
    assert not isinstance(refused.value, TooMany)


def test_values_are_kept(tmp_path):
    scene = dataclasses.replace(like_trained(3), sh=like_trained(3).sh * 5)
    write_scene(tmp_path / "b.glb", scene)
    assert max(differences(read_scene(tmp_path / "b.glb"), scene).values()) < 2e-6


def test_colours_are_told_as_shares_and_bounds_as_the_smaller_and_the_larger_end(path):
    meta = Glb.read(open(path, "rb")).contents
    position, colour = meta["accessors"][:2]
    assert (colour["componentType"], colour["normalized"]) == (5121, True)
    assert (np.array(position["min"]) < position["max"]).all()
