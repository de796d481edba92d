"""Pool and kernels run without a data race, and what the fuzzer has found is kept. More: `make sanitize`,
`make fuzz`."""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
from pathlib import Path

import pytest

from svrgs_bench import variants

ROOT = Path(__file__).resolve().parents[1]
CORPUS = sorted((ROOT / "tests/fuzz/corpus").iterdir())
CXX = os.environ.get("CXX", "g++")


def runtime() -> str:
    """The thread sanitizer's library; empty where the compiler or the library is missing."""
    if variants.missing_tools() or platform.system() != "Linux":
        return ""
    found = subprocess.run(
        [CXX, "-print-file-name=libtsan.so"], capture_output=True, text=True
    ).stdout.strip()
    return found if os.path.isabs(found) else ""


def program(out: Path, library: Path, *words: str):
    """Compiles sources of tests/sanitizers/ with the library."""
    words = [ROOT / "tests/sanitizers" / word if word.endswith(".cc") else word for word in words]
    command = [
        CXX,
        "-std=c++20",
        "-O1",
        "-g",
        "-pthread",
        f"-I{ROOT / 'native/include'}",
        *words,
        library,
        f"-Wl,-rpath,{library.parent}",
        "-o",
        out,
    ]
    subprocess.run(command, check=True)


@pytest.mark.slow
@pytest.mark.skipif(not runtime(), reason="the compiler has no thread sanitizer")
def test_no_data_races(tmp_path):
    """At the levels that every processor has; the others compile the same sources."""
    folder = ROOT / "build" / "sanitize" / "tsan-short"  # kept: built anew only after a change
    configure = [variants.cmake(), "-S", ROOT / "native", "-B", folder, "-Davx=OFF"]
    flags = [f"-DCMAKE_CXX_COMPILER={CXX}", "-DCMAKE_CXX_FLAGS_RELEASE=-O1 -fsanitize=thread"]
    subprocess.run([*configure, *flags], check=True, capture_output=True)
    build = [variants.cmake(), "--build", folder, "--target", "svrgs-debug", "--parallel", "2"]
    subprocess.run(build, check=True, capture_output=True)
    program(tmp_path / "threads", folder / "libsvrgs-debug.so", "threads.cc", "-fsanitize=thread")
    done = subprocess.run(
        [tmp_path / "threads", "2"],
        env=os.environ | {"TSAN_OPTIONS": "halt_on_error=1"},
        capture_output=True,
        text=True,
    )
    assert (done.returncode, done.stdout) == (0, "clean\n"), done.stderr[-3000:]


@pytest.mark.skipif(not shutil.which(CXX) or platform.system() != "Linux", reason="there is no compiler")
def test_what_the_fuzzer_has_found(tmp_path):
    """Each input is refused, or drawn finite and alike at one and at three threads; coverage led to them
    (make fuzz)."""
    program(tmp_path / "replay", ROOT / "svrgs_addon" / "libsvrgs.so", "fuzz.cc", "replay.cc")
    done = subprocess.run([tmp_path / "replay", *CORPUS], capture_output=True, text=True)
    assert (done.returncode, done.stdout) == (0, f"{len(CORPUS)}\n"), done.stderr
