"""`python -m tests.instruction_counts.under_qemu`: instructions of NEON against those of SSE2, both from the
libraries of make package, built by the same clang. Needs Debian's qemu-user and libc6-arm64-cross."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from digests import SYSROOT, library_of, missing
from instruction_counts import HERE, ROOT, write_case

BOUND = 1.15  # NEON's instructions by SSE2's, at most
RUNS = {  # level: target, the emulator, the number of the level
    "baseline": ("x86_64-linux-gnu.2.28", ["qemu-x86_64"]),
    "neon": ("aarch64-linux-gnu.2.28", ["qemu-aarch64", "-L", str(SYSROOT)]),
}


def counts(level: str, case: Path, plugin: Path) -> dict[str, int]:
    """{call: instructions}. Raises subprocess.CalledProcessError if the driver cannot be built or fails."""
    target, emulator = RUNS[level]
    library = library_of(target)
    driver = library.with_name("counted")
    compiler = [
        sys.executable,
        "-m",
        "ziglang",
        "c++",
        "-target",
        target,
        "-std=c++20",
        "-O1",
        "-DCOUNTED_BY_QEMU",
        f"-I{ROOT / 'native/include'}",
    ]
    subprocess.run([*compiler, HERE / "driver.cc", library, "-Wl,-rpath,$ORIGIN", "-o", driver], check=True)
    command = [*emulator, "-plugin", plugin, driver, case, str(library.levels()[level])]
    done = subprocess.run(command, check=True, capture_output=True, text=True)
    marks = [int(line) for line in done.stderr.splitlines() if line.isdigit()]
    # a mark before each call and one after it
    return dict(zip(done.stdout.split(), marks[1::2], strict=True))


def main() -> int:
    if reason := next(filter(None, (missing(target) for target, _ in RUNS.values())), ""):
        print(reason, file=sys.stderr)
        return 1
    with tempfile.TemporaryDirectory() as folder:
        case, plugin = Path(folder, "case.bin"), Path(folder, "counter.so")
        write_case(case)
        subprocess.run(["gcc", "-O1", "-shared", "-fPIC", HERE / "qemu_counter.c", "-o", plugin], check=True)
        sse, neon = (counts(level, case, plugin) for level in RUNS)
    ratios = {call: neon[call] / sse[call] for call in sse}
    print("| call | SSE2 | NEON | ratio |\n|---|---|---|---|")
    for call, ratio in ratios.items():
        print(f"| {call} | {sse[call]:,} | {neon[call]:,} | {ratio:.2f} |")
    return int(max(ratios.values()) > BOUND)


if __name__ == "__main__":
    sys.exit(main())
