"""The wheel svrgs-native: the native library of one platform, for any Python. It travels in the zips of the
extension, and `make package` puts one for each platform into dist/wheels/."""

from __future__ import annotations

import base64
import hashlib
import zipfile
import zlib
from pathlib import Path

from platforms import ROOT, TABLE, VERSION

PACKAGE = "svrgs_native"
INIT = '"""The native core of SVR-GS, a C library (native/ in its sources). svrgs_addon uses it."""\n'
DATE = (2026, 1, 1, 0, 0, 0)  # of every file, so that the same library gives the same bytes


def name_of(library: Path, platform: str) -> str:
    """The file name. The checksum of the library is its build number, so that no cache takes it for another
    one of the same version."""
    build = f"0{zlib.crc32(library.read_bytes()):08x}"
    return f"{PACKAGE}-{VERSION}-{build}-py3-none-{TABLE['platform'][platform]['pip']}.whl"


def write(library: Path, platform: str, folder: Path) -> Path:
    """Writes the wheel of a library into a folder, which is made. Returns its path."""
    path, facts = folder / name_of(library, platform), f"{PACKAGE}-{VERSION}.dist-info"
    tag = path.stem.split("-", 3)[3]
    files = {
        f"{PACKAGE}/__init__.py": INIT.encode(),
        f"{PACKAGE}/{library.name}": library.read_bytes(),
        f"{facts}/licenses/LICENSE": (ROOT / "LICENSE").read_bytes(),
        f"{facts}/METADATA": (
            f"Metadata-Version: 2.4\nName: svrgs-native\nVersion: {VERSION}\nLicense-Expression:"
            " GPL-3.0-or-later\nLicense-File: LICENSE\nSummary: The native core of SVR-GS\n"
        ).encode(),
        f"{facts}/WHEEL": (
            f"Wheel-Version: 1.0\nGenerator: svrgs\nRoot-Is-Purelib: false\nTag: {tag}\n"
        ).encode(),
    }
    rows = [f"{name},sha256={_digest(data)},{len(data)}" for name, data in files.items()]
    files[f"{facts}/RECORD"] = "\n".join([*rows, f"{facts}/RECORD,,", ""]).encode()
    folder.mkdir(parents=True, exist_ok=True)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as wheel:
        for name, data in files.items():
            info = zipfile.ZipInfo(name, DATE)
            info.external_attr, info.compress_type = 0o100644 << 16, zipfile.ZIP_DEFLATED
            wheel.writestr(info, data)
    return path


def _digest(data: bytes) -> str:
    return base64.urlsafe_b64encode(hashlib.sha256(data).digest()).rstrip(b"=").decode()
