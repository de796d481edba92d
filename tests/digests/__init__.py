"""Digests of what every call of the native core gives, to compare systems: digests.cc makes them, digests.txt
holds them.

A level gives the same bits on every system, except where digests.cc says "rounded". AVX2 and AVX-512 start
some divisions with the processor's own estimate: they are the same on one processor, and not recorded.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from svrgs_addon.native.library_path import library_path

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
BUILT = ROOT / "build/platforms"  # the library of a target in a folder each
RECORD = HERE / "digests.txt"
RECORDED_LEVELS = ("scalar", "float64", "baseline", "neon")
# the C library for arm64 (Debian: libc6-arm64-cross)
SYSROOT = Path(os.environ.get("SVRGS_ARM64_SYSROOT", "/usr/aarch64-linux-gnu"))
LIBRARIES = {"linux": "libsvrgs.so", "windows": "svrgs.dll"}
HOST_LEVELS = ("scalar", "float64", "baseline", "avx2", "avx512")
TARGETS = {  # what runs on Linux for x86-64: the levels, and the program before the program
    "x86_64-linux-gnu.2.28": (HOST_LEVELS, []),
    "aarch64-linux-gnu.2.28": (("scalar", "float64", "neon"), ["qemu-aarch64", "-L", str(SYSROOT)]),
    "x86_64-windows-gnu": (HOST_LEVELS, ["wine"]),
}
WINE = {"WINEPREFIX": str(ROOT / "build/wine"), "WINEDEBUG": "-all"}
HOW_TO_BUILD = "make package"


def missing(target: str) -> str:
    """Why the library of a target cannot be run here; empty if it can."""
    _, runner = TARGETS[target]
    if not library_of(target).exists():
        return f"{library_of(target).relative_to(ROOT)} is not built ({HOW_TO_BUILD})"
    if runner and not shutil.which(runner[0]):
        return f"{runner[0]} is not installed"
    if "-L" in runner and not SYSROOT.exists():
        return f"{SYSROOT} is missing (Debian: libc6-arm64-cross)"
    return "" if _zig().returncode == 0 else "ziglang is not installed (requirements-package.txt)"


def library_of(target: str) -> Path:
    return BUILT / target / LIBRARIES[target.split("-")[1]]


def _zig(*words: object) -> subprocess.CompletedProcess:
    return subprocess.run(
        [sys.executable, "-m", "ziglang", *map(str, words or ["version"])], capture_output=True, text=True
    )


def build(folder: Path) -> Path:
    """The program, with this checkout's library or the one that SVRGS_LIBRARY names, by g++."""
    library, program = library_path().resolve(), folder / "digests"
    command = [
        os.environ.get("CXX", "g++"),
        "-std=c++20",
        "-O1",
        f"-I{ROOT / 'native/include'}",
        HERE / "digests.cc",
        library,
    ]
    subprocess.run([*command, f"-Wl,-rpath,{library.parent}", "-o", program], check=True)
    return program


def cross_build(target: str) -> Path:
    """The program for a target, beside its library. Raises RuntimeError with the compiler's words if it
    fails."""
    library = library_of(target)
    windows = library.suffix == ".dll"
    linked = library.with_name("libsvrgs.dll.a") if windows else library
    program = library.with_name("digests.exe" if windows else "digests")
    Path(WINE["WINEPREFIX"]).mkdir(exist_ok=True)
    rpath = [] if windows else ["-Wl,-rpath,$ORIGIN"]
    done = _zig(
        "c++",
        "-target",
        target,
        "-std=c++20",
        "-O1",
        f"-I{ROOT / 'native/include'}",
        HERE / "digests.cc",
        linked,
        *rpath,
        "-o",
        program,
    )
    if done.returncode:
        raise RuntimeError(done.stderr)
    return program


def lines(program: Path, level: str, runner: Sequence[str] = ()) -> list[str]:
    """What the program prints. Raises RuntimeError if a call fails, or differs between one thread and
    three."""
    done = subprocess.run(
        [*runner, program, level],
        capture_output=True,
        text=True,
        stdin=subprocess.DEVNULL,
        env=os.environ | WINE,
    )
    if done.returncode or not done.stdout:  # Wine's exit status is 0 after a crash
        raise RuntimeError(f"{program.name} {level}: status {done.returncode}\n{done.stderr[-2000:]}")
    return done.stdout.splitlines()


def recorded(level: str) -> list[str]:
    text = RECORD.read_text(encoding="utf-8") if RECORD.exists() else ""
    return [line for line in text.splitlines() if line.startswith(f"{level} ")]


def differences(found: list[str], expected: list[str]) -> list[str]:
    """Lines of one that the other lacks."""
    fewer = [f"- {line}" for line in expected if line not in found]
    return fewer + [f"+ {line}" for line in found if line not in expected]
