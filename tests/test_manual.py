"""The manual in the zip: its translations are complete, and every page that a panel opens is there."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

import manual

ROOT = Path(__file__).resolve().parents[1]
pytest.importorskip("sphinx")
TRANSLATIONS = {
    name: json.loads((ROOT / f"docs/manual/{name}.json").read_text("utf-8"))
    for name in manual.LANGUAGES
    if name != "en"
}


@pytest.fixture(scope="module")
def made():
    return manual.build()


def test_every_text_is_translated_and_no_other():
    texts = set(manual.messages())
    assert len(texts) > 200
    for language, found in TRANSLATIONS.items():
        assert set(found) == texts, language
        assert all(found.values()), language


@pytest.mark.parametrize("language", TRANSLATIONS)
def test_links_and_commands_are_those_of_the_english_text(language):
    for english, said in TRANSLATIONS[language].items():
        for what in (r"\]\(([^)]*)\)", r"`([^`]+)`"):
            assert sorted(re.findall(what, english)) == sorted(re.findall(what, said)), said


def test_every_page_that_blender_opens_is_there(made):
    sources = [*(ROOT / "panels").glob("*.py"), ROOT / "operators/view/manual.py"]
    pages = re.findall(r'"(\w+\.html)(?:#([\w-]+))?"', "".join(path.read_text("utf-8") for path in sources))
    pages += [("blender.html", step) for step in ("train", "prune", "compare", "export")]
    assert len(pages) > 12
    for language in manual.LANGUAGES:
        for page, section in pages:
            text = (made / language / page).read_text("utf-8")
            assert not section or f'id="{section}"' in text, f"{page}#{section}"


def test_no_page_asks_another_server_for_anything(made):
    for page in made.rglob("*.html"):
        loaded = re.findall(r'(?:src|href)="(https?:[^"]+)"', page.read_text("utf-8"))
        assert not [link for link in loaded if re.search(r"\.(js|css|png|svg|woff2?)\b", link)], page


def test_search_knows_words_of_each_language(made):
    for language, word in (("en", "prune"), ("de", "ausdunn"), ("zh", "剪枝")):
        words = (made / language / "searchindex.js").read_text("utf-8").encode().decode("unicode_escape")
        assert word in words.lower(), language
