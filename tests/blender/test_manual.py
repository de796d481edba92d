"""The manual in the zip: a button opens a page of it in the browser, in the language of Blender."""

from __future__ import annotations

import webbrowser

import bpy
import pytest
from extension import part


@pytest.fixture
def opened(monkeypatch):
    """The addresses that a browser was asked to show."""
    found = []
    monkeypatch.setattr(webbrowser, "open", found.append)
    return found


@pytest.mark.parametrize(
    "locale, folder", [("en_US", "en"), ("de_DE", "de"), ("zh_HANS", "zh"), ("fr_FR", "en"), ("", "en")]
)
def test_a_page_opens_in_the_language_of_blender(opened, locale, folder, monkeypatch):
    monkeypatch.setattr(part("operators.view.manual"), "locale", lambda: locale)
    assert bpy.ops.svrgs.manual(page="blender.html#prune") == {"FINISHED"}
    file = part("operators.view.manual").FOLDER / folder / "blender.html"
    assert opened == [f"{file.as_uri()}#prune"] and file.is_file()


def test_online_manual_knows_the_page_of_an_operator(opened):
    bpy.ops.wm.doc_view_manual(doc_id="svrgs.select_gaussians")
    bpy.ops.wm.doc_view_manual(doc_id="svrgs.job_start")
    assert [address.rpartition("/")[2] for address in opened] == ["selection.html#in-blender", "jobs.html"]


def test_without_the_manual_it_says_so(opened, monkeypatch, tmp_path):
    monkeypatch.setattr(part("operators.view.manual"), "FOLDER", tmp_path)
    with pytest.raises(RuntimeError, match="only the zip of the extension holds it"):
        bpy.ops.svrgs.manual(page="blender.html")
    assert opened == []
