"""What commands leave behind: their measures, their files, and the sentence of a refusal."""

from __future__ import annotations

import re
from pathlib import Path

MEASURES = {"psnr", "ssim", "lpips", "flip", "count", "bytes", "ms_per_frame"}
TEST_VIEWS = ["00", "08"]


def command_words(*parts: object) -> list[str]:
    """Of a command line: a text is several words, apart by spaces; all else is one."""
    return [word for part in parts for word in (part.split() if isinstance(part, str) else [str(part)])]


def files(folder: Path) -> dict[str, bytes]:
    return {
        path.relative_to(folder).as_posix(): path.read_bytes() for path in folder.rglob("*") if path.is_file()
    }


def refused(done, *words: str):
    """Exit 2, nothing on stdout, one line on stderr that holds the words."""
    assert (done.status, done.out) == (2, ""), done
    lines = [line for line in done.err.splitlines() if line.strip()]
    assert len(lines) == 1 and re.match("svrgs[a-z ]*: ", lines[0]), done.err
    assert all(word in lines[0] for word in words), done.err
