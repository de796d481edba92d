"""What the library says of itself: thresholds, names; and that the table of outputs is that of its
interface."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from reference import rasterize as ref
from svrgs_addon.native import library
from svrgs_addon.native.outputs import OUTPUTS

HEADER = (Path(__file__).parents[1] / "native" / "include" / "svrgs.h").read_text()


def fields(struct: str) -> list[str]:
    """Names in a struct of svrgs.h, in their order."""
    bodies = re.findall(r"typedef struct \{(.*?)\} (\w+);", HEADER, re.DOTALL)
    body = next(body for body, name in bodies if name == struct)
    statements = re.sub(r"/\*.*?\*/", "", body, flags=re.DOTALL).split(";")
    return [
        re.findall(r"\w+", name)[-1]
        for statement in statements
        for name in statement.split(",")
        if name.strip()
    ]


def enum(name: str) -> list[str]:
    """Values of an enum of svrgs.h."""
    return re.findall(r"(SVRGS_\w+)", re.search(rf"enum {name} \{{(.*?)\}}", HEADER, re.DOTALL)[1])


def test_arguments_are_those_of_the_header():
    letters = {"int32_t": "i", "int64_t": "l", "uint64_t": "u", "double": "d"}
    found = {}
    for name, arguments in re.findall(
        r"^SVRGS_API [^(]*?(svrgs_\w+)\((.*?)\);", HEADER, re.DOTALL | re.MULTILINE
    ):
        if arguments != "void":
            kinds = [
                "p" if re.search(r"[*\[]", one) else letters[one.split()[0]] for one in arguments.split(",")
            ]
            found[name] = "".join(kinds)
    assert library.ARGUMENTS == found


def test_thresholds_are_those_of_the_reference():
    found = library.thresholds()
    expected = {
        "near": ref.NEAR,
        "blur": ref.BLUR,
        "alpha_cut": ref.ALPHA_MIN,
        "alpha_max": ref.ALPHA_MAX,
        "stop": ref.T_MIN,
        "frustum_margin": ref.FRUSTUM_MARGIN,
        "compensation_floor": ref.DET_RATIO_MIN,
    }
    assert {name: getattr(found, name) for name in expected} == expected
    assert found.far > 1e6 and found.tile % found.block_width == found.tile % found.block_height == 0
    assert len(fields("svrgs_thresholds")) == len(found)


def test_names_are_those_of_the_enums():
    def of(names, prefix: str) -> list[str]:
        return [f"{prefix}_{name.upper()}" for name in names]

    assert of(library.mask_kinds(), "SVRGS_MASK") == enum("svrgs_mask_kind")[:-1]
    assert of(library.stages(), "SVRGS") == enum("svrgs_stage")[:-1]
    assert of(library.skips(), "SVRGS") == enum("svrgs_skip")[:-1]
    assert [name.replace("DOUBLE", "FLOAT64") for name in enum("svrgs_level")[:-1]] == of(
        library.levels(), "SVRGS"
    )
    assert list(library.skips().values()) == [1, 2, 4, 8]


@pytest.mark.parametrize("index", [-1, 1000])
def test_there_is_no_name_outside_an_enum(index):
    ask = library.library().svrgs_name
    assert [ask(names, index) for names in (0, 1, 2, 3)] == [None] * 4
    assert ask(4, 0) is None and ask(-1, 0) is None


def test_outputs_are_in_the_order_of_the_interface():
    assert list(OUTPUTS) == fields("svrgs_images")
    assert [name for name, output in OUTPUTS.items() if output.differentiable] == fields("svrgs_image_grads")
    assert all(name == output.name for name, output in OUTPUTS.items())


def test_outputs_name_each_pass_once():
    passes = [output.render_pass[0] for output in OUTPUTS.values() if output.render_pass]
    assert len(set(passes)) == len(passes) and {"SplatAlpha", "Count", "Depth", "SpatialMask"} == set(passes)
    assert "Alpha" not in passes, "Blender's compositor has an output of that name: the alpha of the picture"
    assert {output.shown for output in OUTPUTS.values()} <= {"", "plain", "mask_map", "farthest"}
