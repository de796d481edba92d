"""Downloads packages whose checksum is pinned."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path


def download(package: str, sha256: str, folder: Path, *words: str) -> Path:
    """The file of a package ("name==version"), in an empty folder. pip compares its checksum before it opens
    it. words: further options of pip. Raises CalledProcessError."""
    wanted = folder / "wanted.txt"
    wanted.write_text(f"{package} --hash=sha256:{sha256}\n")
    command = [sys.executable, "-m", "pip", "download", "-qq", "--disable-pip-version-check", "--no-deps"]
    subprocess.run([*command, *words, "--require-hashes", "-r", wanted, "-d", folder], check=True)
    wanted.unlink()
    return next(folder.iterdir())
