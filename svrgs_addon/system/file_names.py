"""Names of files: those that Windows forbids, paths too long for it, and links."""

from __future__ import annotations

import ntpath
import os
import re
from pathlib import Path, PureWindowsPath

from . import here

DEVICES = re.compile(r"(con|prn|aux|nul|com[1-9¹²³]|lpt[1-9¹²³]|conin\$|conout\$) *(\..*)?", re.IGNORECASE)
FORBIDDEN = re.compile(r'[<>:"|?*\x00-\x1f]')
LONGEST = 247  # characters of the path of a folder on Windows, without the prefix; a file may have 12 more
PREFIX = "\\\\?\\"
JUNCTION = 0xA0000003  # tag of a folder of Windows that leads to another one, which anybody may create


def what_is_forbidden(path: str | os.PathLike) -> str:
    """What the system forbids in the names of a path as the user wrote it, as the end of a sentence; '' if
    nothing.

    Without this check, Windows would write `NUL.ply` to no file, and `a:b.ply` into a hidden stream of the
    file `a`.
    """
    if not here.WINDOWS:
        return ""
    whole = PureWindowsPath(path)
    for name in whole.parts[bool(whole.anchor) :]:
        if found := FORBIDDEN.search(name):
            return f"Windows does not allow {found[0]!r} in a name"
        if DEVICES.fullmatch(name):
            return f"on Windows, '{name}' is a device and no file"
        if name[-1] in ". " and name != "..":
            return f"Windows does not allow a name that ends with a {'dot' if name[-1] == '.' else 'space'}"
    return ""


def extended(path: str | os.PathLike) -> Path:
    """The path in the form in which the system opens it. On Windows, a path of more than LONGEST characters
    becomes absolute, without '..', and gets the prefix that lifts the limit of 260 characters."""
    path = Path(path)
    text = os.fspath(path)
    if not here.WINDOWS or text.startswith(PREFIX):
        return path
    full = ntpath.normpath(ntpath.join(os.getcwd(), text))
    if len(full) <= LONGEST:
        return path
    return Path(PREFIX + ("UNC" + full[1:] if full.startswith("\\\\") else full))


def real(path: str | os.PathLike) -> Path:
    """The absolute path without symbolic links, as extended(). Links that Windows cannot follow stay."""
    try:
        return extended(os.path.realpath(path))
    except OSError:
        return extended(os.path.abspath(path))


def is_link(path: str | os.PathLike) -> bool:
    """Whether it is a symbolic link, or a junction of Windows. Raises OSError if there is nothing."""
    return os.path.islink(path) or getattr(os.lstat(path), "st_reparse_tag", 0) == JUNCTION


def remove_link(path: Path) -> bool:
    """Removes a symbolic link or a junction, not what it leads to. Returns whether it was one."""
    if not os.path.lexists(path) or not is_link(path):
        return False
    path.unlink() if path.is_symlink() else path.rmdir()
    return True


def shown(text: str) -> str:
    """The text with its paths as the user wrote them. Python's own errors double each backslash."""
    if here.WINDOWS:
        for single in ("\\\\", "\\"):
            prefix = PREFIX.replace("\\", single)
            text = text.replace(f"{prefix}UNC", single).replace(prefix, "")
    return text
