"""The table platforms.toml: which zips there are, and what is in each."""

from __future__ import annotations

import platform
import re
import sys
import tomllib
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
TABLE = tomllib.loads((ROOT / "tools/platforms.toml").read_text(encoding="utf-8"))
VERSION = re.search(
    r'^__version__ = "(.+)"$', (ROOT / "svrgs_addon/__init__.py").read_text(encoding="utf-8"), re.MULTILINE
)[1]
FIRST_BLENDER = min(facts["min"] for facts in TABLE["blender"].values())
# wheels of packages; native libraries, in a folder for each target
WHEELS, BUILT = ROOT / "wheels", ROOT / "build/platforms"
LIBRARIES = {"linux": "libsvrgs.so", "windows": "svrgs.dll", "macos": "libsvrgs.dylib"}
MACHINES = {"x86_64": "x64", "amd64": "x64", "aarch64": "arm64", "arm64": "arm64"}
SYSTEMS = {"linux": "linux", "win32": "windows", "darwin": "macos"}


@dataclass(frozen=True)
class Variant:
    """One zip of the extension: for a platform, and for the Blenders with one Python."""

    platform: str  # a key of TABLE["platform"]
    blender: str  # a key of TABLE["blender"]

    @property
    def facts(self) -> dict:
        return TABLE["blender"][self.blender]

    @property
    def version(self) -> str:
        """Of the zip. A shop takes two of one platform only with two versions: those for later Blenders have
        the next one, so releases have an even last number."""
        first, _, last = VERSION.rpartition(".")
        return f"{first}.{int(last) + (self.facts['min'] != FIRST_BLENDER)}"

    @property
    def name(self) -> str:
        return f"svrgs-{self.version}-{self.platform}-{self.blender}"

    @property
    def library(self) -> str:
        """File name of the native library."""
        return LIBRARIES[self.platform.partition("-")[0]]

    @property
    def built_library(self) -> Path:
        return BUILT / TABLE["platform"][self.platform]["target"] / self.library

    def fits(self, platform: str, python: str) -> bool:
        return (self.platform, self.facts.get("python")) == (platform, python)

    def wheels(self) -> list[Path]:
        """Those in WHEELS that belong to it. Raises FileNotFoundError if one was not downloaded."""
        return [self._wheel(*package.split("==")) for package in self.facts["packages"]]

    def _wheel(self, package: str, version: str) -> Path:
        python = self.facts["python"]
        for found in sorted(WHEELS.glob(f"{package}-{version}-{python}-{python}-*.whl")):
            if set(found.stem.split("-")[-1].split(".")) & set(TABLE["platform"][self.platform]["wheels"]):
                return found
        raise FileNotFoundError(
            f"{package} {version} for {self.platform}, {python} is not in {WHEELS}: run tools/fetch_wheels.py"
            " --all"
        )


def variants() -> list[Variant]:
    """All of them, in the order of the table."""
    with_wheels = [name for name, facts in TABLE["platform"].items() if "wheels" in facts]
    found = []
    for blender, facts in TABLE["blender"].items():
        platforms = facts.get("platforms", with_wheels if facts["packages"] else list(TABLE["platform"]))
        found += [Variant(platform, blender) for platform in platforms]
    return found


def this_platform() -> str:
    """Blender's name of the platform this runs on."""
    machine = MACHINES.get(platform.machine().lower(), platform.machine())
    return f"{SYSTEMS.get(sys.platform, sys.platform)}-{machine}"


def variant_for(python: str) -> Variant:
    """The one for this platform and a Python (cp311); that without packages if there is none with them."""
    here = this_platform()
    return next(
        (variant for variant in variants() if variant.fits(here, python)), Variant(here, "any-python")
    )
