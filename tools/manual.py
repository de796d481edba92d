"""Makes the manual from docs/, in each language, in build/manual: python tools/manual.py

docs/manual/LANGUAGE.json holds {English text: text in that language} of the pages TRANSLATED; all other pages
are in English everywhere. With --messages it prints the texts that have no translation yet.
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path

from platforms import ROOT

DOCS, MADE = ROOT / "docs", ROOT / "build/manual"
LANGUAGES = {"en": "en", "de": "de", "zh": "zh_CN"}  # folder of the manual: name of the language in Sphinx
# no words, code alone, HTML, or a picture, whose words are a text of its own
NO_TEXT = re.compile(r"[^a-zA-Z]*$|(`[^`]*`(, )?)+$|<|!\[")
TRANSLATED = ("index", "blender", "selection", "rendering", "jobs")  # pages


def build() -> Path:
    """The folder of the manual, made where its sources have changed. Raises RuntimeError with what Sphinx
    said."""
    sources = [Path(__file__), *DOCS.glob("*.md"), *DOCS.glob("manual/*.*"), *DOCS.glob("pictures/*")]
    digest = hashlib.sha256(b"".join(path.read_bytes() for path in sorted(sources))).hexdigest()
    folder = MADE / digest[:16]
    if not folder.is_dir():
        MADE.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(dir=MADE) as temp:
            made = Path(temp) / "manual"
            for name, language in LANGUAGES.items():
                locale = catalogue(name, Path(temp) / "locale" / language / "LC_MESSAGES")
                _sphinx("html", made / name, f"language={language}", f"locale_dirs={locale}")
                (made / name / ".buildinfo").unlink()
                mend_search(made / name / "_static" / "translations.js")
            with contextlib.suppress(OSError):  # another process was faster
                made.rename(folder)
    return folder


def catalogue(language: str, folder: Path) -> Path:
    """Writes the translations of a language as Sphinx reads them. Returns the folder of all languages."""
    from babel.messages import mofile
    from babel.messages.catalog import Catalog

    file = DOCS / "manual" / f"{language}.json"
    found = Catalog(locale=LANGUAGES[language])
    for text, said in (json.loads(file.read_text("utf-8")) if file.is_file() else {}).items():
        found.add(text, said)
    folder.mkdir(parents=True)
    with (folder / "manual.mo").open("wb") as out:
        mofile.write_mo(out, found)
    return folder.parents[1]


def mend_search(file: Path) -> None:
    """Sphinx's translations say by a truth value which of two sentences to take, where a number is needed;
    the search stops there. Those of German have no such sentences."""
    if file.is_file():
        text = re.sub(r'("plural_expr": ")(\(n != 1\)")', r"\1+\2", file.read_text("utf-8"))
        sentences = '"Suche beendet, eine Seite gefunden.", "Suche beendet, ${resultCount} Seiten gefunden."'
        file.write_text(re.sub(r'"",\s*""', lambda _: sentences, text), "utf-8")


def messages() -> list[str]:
    """The English texts of the pages that are translated."""
    from babel.messages import pofile

    with tempfile.TemporaryDirectory() as temp:
        _sphinx("gettext", Path(temp))
        with (Path(temp) / "manual.pot").open("rb") as file:
            found = pofile.read_po(file)
    return [
        message.id
        for message in found
        if any(Path(page).stem in TRANSLATED for page, _ in message.locations)
        and not NO_TEXT.match(message.id)
    ]


def _sphinx(builder: str, folder: Path, *settings: str) -> None:
    words = [word for setting in settings for word in ("-D", setting)]
    with tempfile.TemporaryDirectory() as read:
        program = [sys.executable, "-m", "sphinx", "-q", "-W", "-b", builder, "-d", read]
        done = subprocess.run(
            [*program, "-c", str(DOCS / "manual"), *words, str(DOCS), str(folder)],
            capture_output=True,
            encoding="utf-8",
        )
    if done.returncode:
        raise RuntimeError(done.stdout + done.stderr)


def main() -> None:
    if "--messages" not in sys.argv:
        print(build())
        return
    for language in LANGUAGES:
        if language != "en":
            known = json.loads((DOCS / "manual" / f"{language}.json").read_text("utf-8"))
            left = {text: "" for text in messages() if text not in known}
            print(json.dumps({language: left}, ensure_ascii=False, indent=1))


if __name__ == "__main__":
    main()
