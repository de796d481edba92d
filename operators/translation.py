"""Texts in other languages: registers the catalogues with Blender. catalogues/LOCALE.json holds {English
text: text in that language}.

Blender itself translates names, descriptions and the texts that a panel gives to its layout. Every other text
goes through pgettext_iface, called `tr`: a whole sentence with named fields, which are filled in afterwards.
pgettext_n, called `n_`, marks a text that is translated where it is shown. Sentences of svrgs_addon, which
knows no Blender, stay in English; so do names of files and data.

Blender's own translation of a text comes first. A property with a word that Blender uses in another sense has
translation_context=OWN.
"""

from __future__ import annotations

import json
from pathlib import Path

import bpy

FOLDER = Path(__file__).with_name("catalogues")
OWN = "SVR-GS"  # a context that Blender's own translations do not have


def catalogues() -> dict[str, dict[tuple[str, str], str]]:
    """{locale: {(context, English text): translation}}. Blender looks for the labels of operators in a
    context of their own."""
    contexts = bpy.app.translations.contexts.default, bpy.app.translations.contexts.operator_default, OWN
    found = {file.stem: json.loads(file.read_text("utf-8")) for file in sorted(FOLDER.glob("*.json"))}
    return {
        locale: {(context, text): said for text, said in texts.items() for context in contexts}
        for locale, texts in found.items()
    }


def register():
    bpy.app.translations.register(__name__, catalogues())


def unregister():
    bpy.app.translations.unregister(__name__)
