"""Fetches the program of exported web pages: python tools/fetch_web_modules.py.

Spark draws Gaussian splats with three.js. Both lie in the wheel of fiftyone, which shows splats with them, as
four JavaScript modules. They are packed into svrgs_addon/viewer/web/modules/, which web_page.py copies. The
checksum of the wheel is pinned.
"""

from __future__ import annotations

import gzip
import sys
import tempfile
import zipfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))
from pinned import download
from svrgs_addon.files.atomic import write_bytes
from svrgs_addon.viewer.web_page import MODULES, packed_module

PACKAGE = "fiftyone==1.22.1"
SHA256 = "a5a216ac6aea97fccee95e583d85ffe0de228c7dcd480bd295d3c8c637d13b3e"
FOLDER = "fiftyone/server/static/assets"


def main() -> None:
    if all(packed_module(name).exists() for name in MODULES):
        return
    with (
        tempfile.TemporaryDirectory() as folder,
        zipfile.ZipFile(download(PACKAGE, SHA256, Path(folder))) as wheel,
    ):
        for name in MODULES:
            packed_module(name).parent.mkdir(exist_ok=True)
            write_bytes(packed_module(name), gzip.compress(wheel.read(f"{FOLDER}/{name}"), 9, mtime=0))
    print(f"{packed_module(MODULES[0]).parent}: written")


if __name__ == "__main__":
    main()
