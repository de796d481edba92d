"""No text of Blender's panels and operators is hard-wired: each is in every catalogue, whole, and with the
same fields."""

from __future__ import annotations

import ast
import json
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from blender.messages import TRANSLATED, called, catalogues, fields, is_text, messages_of, sources

ROOT = Path(__file__).resolve().parents[1]
CATALOGUES = catalogues(ROOT)
PENDING: set[str] = set()  # files whose texts still have to be translated
SENTENCE = re.compile(r"[^\W\d_]{2,}[,;:.]? [^\W\d_]{2,}")  # two words
WORD = re.compile(r"[^\W\d_]{3,}")
NO_TEXT = {  # in English everywhere
    # names of images, objects, modifiers and sockets: scripts and .blend files know data by name
    "SVR-GS Contact Sheet", "SVR-GS Spatial Mask", "SVR-GS Wipe", "SVR-GS Removed", "Base Color",
    "SVR-GS Masked Out",
    "f'SVR-GS {name}'", "f'{name} (former)'",
    "f'{original.name} pruned'", "f'{source.name} pruned'", "f'{Path(self.scene).stem} pruned'",
    "f'{obj.name} pruned'", "f'{name} points'",
    "f'{root.name} splat'", "f'{scene.name} Splats'", "f'{scene.name} Compositing'", "SVR-GS Splats",
    "SVR-GS Around Render", "In Front",
    "f'SVR-GS: {error}'",  # a line in the console
    # the whole description is in the catalogues
    "f'. Empty: {option.default_help}'",
    "f'Number of training steps. {QUICK:,} give a usable splat, {ITERATIONS:,} one as in papers'",
    "f'visible_{kind}'", "f'CompositorNode{kind}'", "To Straight", "To Premultiplied",  # names of Blender
    "Name of the empty above the cameras", "Folder of the job",  # of hidden properties
    "f'{UNDISTORTED}/{name}.png'",  # a file
    "f'svrgs.job_{action}'",  # an operator
}  # fmt: skip
CODE = {"operators/data/gpu_drawing.py"}  # shaders and what their constants mean


def label(file: Path) -> str:
    return str(file.relative_to(ROOT))


def docstrings(tree: ast.AST) -> set[ast.AST]:
    return {
        node.value
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    }


def glued(tree: ast.AST) -> Iterator[str]:
    """f-strings, sums and products of text that hold words: in another language the words have another
    order."""
    for node in ast.walk(tree):
        if isinstance(node, ast.JoinedStr):
            if any(WORD.search(part.value) for part in node.values if is_text(part)):
                yield ast.unparse(node)
        elif isinstance(node, ast.BinOp) and isinstance(node.op, ast.Add | ast.Mult):
            if any(is_text(side) and WORD.search(side.value) for side in (node.left, node.right)):
                yield ast.unparse(node)
        elif called(node) in TRANSLATED and not isinstance(
            node.args[0],
            ast.Constant | ast.IfExp | ast.BoolOp | ast.Name | ast.Attribute | ast.Subscript | ast.Call,
        ):
            yield ast.unparse(node)


def sentences(tree: ast.AST) -> Iterator[str]:
    """Texts of two words or more."""
    skipped = docstrings(tree) | {
        part for node in ast.walk(tree) if isinstance(node, ast.JoinedStr) for part in node.values
    }
    for node in ast.walk(tree):
        if is_text(node) and node not in skipped and SENTENCE.search(node.value):
            yield node.value


@pytest.mark.parametrize("file", sources(ROOT), ids=label)
def test_no_text_is_hard_wired(file):
    if label(file) in PENDING:
        pytest.skip("its texts still have to be translated")
    tree = ast.parse(file.read_text("utf-8"))
    known = set.intersection(*map(set, CATALOGUES.values())) | NO_TEXT
    # a whole sentence with named fields: tr('{count:,} Gaussians').format(count=…)
    assert not [text for text in glued(tree) if text not in NO_TEXT]
    # tr(), and an entry in each catalogue
    assert label(file) in CODE or not [text for text in sentences(tree) if text not in known]


def test_every_file_that_still_has_to_be_translated_exists():
    assert PENDING <= {label(file) for file in sources(ROOT)}


def test_hard_wired_texts_would_be_found():
    code = """
report("Two words")
label(text=f"{n} Gaussians")
label(text="Kept " + name)
text += " splats" * many
tr(f"{n}")
tr("Two words")
x = f"{a}: {b}"
"""
    tree = ast.parse(code)
    assert len(list(glued(tree))) == 4 and list(sentences(tree)) == ["Two words", "Two words"]


@pytest.mark.parametrize("locale", CATALOGUES)
def test_catalogues_are_whole(locale):
    texts = CATALOGUES[locale]
    assert sorted(messages_of(ROOT) - texts.keys()) == [], "texts without a translation"
    assert not [text for text, said in texts.items() if not said.strip()]
    # other fields than the English text
    assert not {text: said for text, said in texts.items() if fields(text) != fields(said)}
    written = (ROOT / f"operators/catalogues/{locale}.json").read_text("utf-8")
    # sorted, one text a line, UTF-8
    assert written == json.dumps(texts, ensure_ascii=False, indent=0, sort_keys=True) + "\n"


def test_there_are_catalogues_with_the_names_that_blender_uses():
    assert {"de_DE", "zh_HANS"} <= CATALOGUES.keys()
    assert len({frozenset(texts) for texts in CATALOGUES.values()}) == 1, "all have the same texts"
