"""Digests of files and of splats."""

from __future__ import annotations

import hashlib
from pathlib import Path

from .registry import INDEXES


def sha256(path: Path) -> str:
    """Of a file, in hexadecimal digits. Raises OSError."""
    with open(path, "rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def scene_sha256(path: Path) -> str:
    """Of a splat, in hexadecimal digits: of its file, or of all in its folder. Empty if there is none."""
    folder = path if path.is_dir() else path.parent if path.name in INDEXES else None
    files = [path] if folder is None else sorted(one for one in folder.rglob("*") if one.is_file())
    if files and files[0].is_file():
        return hashlib.sha256("".join(sha256(one) for one in files if one.is_file()).encode()).hexdigest()
    return ""
