"""Instructions the native core needs for fixed small cases, counted by valgrind: the same on every run,
whatever else runs.

counts.json holds what they were when last recorded. Times vary by a tenth from run to run on a shared
machine; a loss of a few per cent shows here alone. One thread; levels as valgrind knows them (it has no
AVX-512).
"""

from __future__ import annotations

import json
import os
import platform
import re
import shutil
import subprocess
from pathlib import Path

import numpy as np

from svrgs_addon.native import library
from svrgs_bench.scenes import orbit_camera, room

HERE = Path(__file__).parent
ROOT = HERE.parents[1]
LIBRARY = ROOT / "svrgs_addon" / "libsvrgs.so"
RECORD = HERE / "counts.json"
LEVELS = ("scalar", "baseline", "avx2")
GAUSSIANS, WIDTH, HEIGHT = 3000, 160, 96
TOLERANCE = 0.03
HOW_TO_RECORD = "python -m tests.instruction_counts --record"

Counts = dict[str, int]  # "level call": instructions


def missing() -> str:
    """Why nothing can be counted here; empty if it can."""
    if not (valgrind := shutil.which("valgrind")):
        return "valgrind is not installed"
    header = Path(valgrind).parents[1] / "include" / "valgrind" / "callgrind.h"
    return "" if header.exists() else f"{header} is missing (install valgrind's headers)"


def builder() -> str:
    """What compiled the library, as it says itself, and for what machine."""
    found = re.findall(rb"(GCC: |clang version )(?:\([^)\0]*\) )?(\d+\.\d+\.\d+)", LIBRARY.read_bytes())
    names = {f"{name.decode().split()[0].rstrip(':')} {version.decode()}" for name, version in found}
    return ", ".join([*sorted(names), platform.machine()])


def measure(folder: Path) -> Counts:
    """Every count of this build; folder: for what is made on the way."""
    driver, case = folder / "driver", folder / "case.bin"
    command = [
        os.environ.get("CXX", "g++"),
        "-std=c++20",
        "-O1",
        f"-I{ROOT / 'native' / 'include'}",
        HERE / "driver.cc",
        LIBRARY,
    ]
    subprocess.run([*command, f"-Wl,-rpath,{LIBRARY.parent}", "-o", driver], check=True)
    write_case(case)
    counts = {}
    for level in (level for level in LEVELS if level in library.supported_levels()):
        out = folder / f"{level}.out"
        tool = ["valgrind", "--quiet", "--tool=callgrind", f"--callgrind-out-file={out}"]
        subprocess.run([*tool, driver, case, str(library.levels()[level])], check=True)
        counts |= {f"{level} {call}": count for call, count in _dumps(out)}
    return counts


def write_case(path: Path):
    scene, camera = room(GAUSSIANS), orbit_camera(WIDTH, HEIGHT)
    masks = (np.arange(GAUSSIANS) % 5 > 0).astype(np.uint8)
    intrinsics = (camera.K[0, 0], camera.K[1, 1], camera.K[0, 2], camera.K[1, 2])
    with open(path, "wb") as file:
        np.array([GAUSSIANS, scene.sh.shape[1], WIDTH, HEIGHT], np.int32).tofile(file)
        np.array([*camera.viewmat.ravel(), *intrinsics], np.float64).tofile(file)
        for array in (scene.means, scene.log_scales, scene.quats, scene.opacity_logits, scene.sh, masks):
            array.tofile(file)


def _dumps(out: Path):
    """(name, instructions) of each of callgrind's dumps: out.1, out.2, ..."""
    for path in sorted(out.parent.glob(f"{out.name}.*"), key=lambda path: int(path.suffix[1:])):
        text = path.read_text()
        yield (
            re.search(r"Client Request: (\w+)", text)[1],
            int(re.search(r"^totals: (\d+)", text, re.MULTILINE)[1]),
        )


def recorded() -> dict:
    """{'builder': what builder() said, 'counts': Counts}"""
    return json.loads(RECORD.read_text())


def record(counts: Counts):
    RECORD.write_text(json.dumps({"builder": builder(), "counts": counts}, indent=2) + "\n")


def changes(counts: Counts, before: Counts) -> tuple[list[str], list[str]]:
    """Sentences on what grew beyond the tolerance (or was never recorded), and on what shrank beyond it."""
    new = [
        f"{name}: {count:,} instructions, not recorded before"
        for name, count in counts.items()
        if name not in before
    ]
    share = {name: count / before[name] - 1 for name, count in counts.items() if name in before}
    lines = {
        name: f"{name}: {counts[name]:,} instructions, {change:+.1%} against the {before[name]:,} recorded"
        for name, change in share.items()
    }
    return new + [lines[name] for name in share if share[name] > TOLERANCE], [
        lines[name] for name in share if share[name] < -TOLERANCE
    ]
