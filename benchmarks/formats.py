"""How large and how exact each format is: bytes, quality against the original, seconds to write and to read.

python benchmarks/formats.py SPLAT... [--against ORIGINAL] [--quantise FACTOR...] [--sh-degree N...]
    [--data DATASET] [--others] [--out TABLE.md]

PSNR in dB, SSIM and FLIP are means of the 50 views from above of judges.py, against the splat itself or, of
one that was pruned, its original. Seconds: medians of REPEATS, of the scene in memory to the file and back.
With --quantise or --sh-degree, only formats that round SH, newest versions. With --data, figures are those
of its test views against the photographs, LPIPS (make lpips) instead of FLIP; formats that round by where a
splat is seen from, or hold fewer bands, are written without that and with the training views, as by `svrgs
convert --data`. With --others, files of the same
splats by other programs, too (other_writers.py), each written once: a SOG takes them minutes.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from statistics import median

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from judges import Judge, against_photographs, against_scene
from other_writers import OTHERS, others
from svrgs_addon.files.registry import FORMATS, format_to_write, load_scene, write_scene
from svrgs_addon.files.sh_rounding import SeenFrom
from svrgs_addon.prune.options import DatasetOptions
from svrgs_addon.prune.plans import dataset_of
from svrgs_addon.prune.seen import fewer_bands, seen_from
from svrgs_addon.scene.camera import Camera
from svrgs_addon.scene.gaussians import Scene

REPEATS = 5
HEAD = (
    "| file | bytes per Gaussian | MB | PSNR, dB | SSIM | {} | write, s | read, s"
    " |\n|---|---:|---:|---:|---:|---:|---:|---:|"
)


def seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    times = []
    for _ in range(repeats):
        started = time.perf_counter()
        work()
        times.append(time.perf_counter() - started)
    return median(times)


@dataclass(frozen=True)
class Kind:
    """A way to write a file. by_views: rounded by where the splat is seen from."""

    suffix: str
    version: int = 0
    quantise: float = 1.0
    degree: int = 3
    by_views: bool = False
    program: str = ""  # another one that writes it

    @property
    def name(self) -> str:
        words = [self.suffix, f"version {self.version}" if self.version else ""]
        words += [f"--quantise {self.quantise:g}" if self.quantise != 1 else ""]
        words += [f"--sh-degree {self.degree}" if self.degree < 3 else "", "by views" * self.by_views]
        words += [f"by {self.program}" if self.program else ""]
        return " ".join(filter(None, words))

    def banded(self, scene: Scene, cameras: list[Camera]) -> Scene:
        """The scene with as many SH bands as are written."""
        if self.program:
            return scene
        most = format_to_write(f"scene{self.suffix}").most_degree
        return fewer_bands(scene, min(self.degree, most), cameras if self.by_views else ())

    def write(self, path: Path, scene: Scene, seen: SeenFrom | None):
        if self.program:
            OTHERS[self.program, self.suffix](path, scene)
        else:
            write_scene(path, scene, self.version, self.quantise, seen)


def kinds(factors: list[float], degrees: list[int], with_views: bool) -> list[Kind]:
    """All formats that are written; those that round SH, if factors or degrees are given."""
    some = bool(factors or degrees)
    written = [one for one in FORMATS if one.write and one.suffixes and (one.quantises or not some)]
    by_views = (False, True) if with_views else (False,)
    return [
        Kind(one.suffixes[0], version, factor, degree, view)
        for one in written
        for version in ((0,) if some or with_views else one.versions or (0,))
        for factor in factors or [1.0]
        for degree in degrees or [3]
        for view in (by_views if one.quantises or one.most_degree < 3 else (False,))
    ]


def rows(scene: Scene, judge: Judge, wanted: list[Kind], cameras: list[Camera], folder: Path) -> list[str]:
    lines = []
    for kind in wanted:
        path = folder / f"scene{kind.suffix}"
        banded = kind.banded(scene, cameras)
        seen = seen_from(banded, cameras, path) if kind.by_views else None
        writing = seconds(partial(kind.write, path, banded, seen), 1 if kind.program else REPEATS)
        reading = seconds(lambda path=path: load_scene(path))
        found, size = judge(load_scene(path)), path.stat().st_size
        quality = f"{found[0]:.2f} | {found[1]:.4f} | {found[2]:.4f}" if found[0] < 100 else "equal | 1 | 0"
        lines.append(
            f"| {kind.name} | {size / scene.count:.1f} | {size / 1e6:.2f} | {quality} | {writing:.2f} |"
            f" {reading:.2f} |"
        )
        print(lines[-1], flush=True)
    return lines


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("splats", type=Path, nargs="+")
    parser.add_argument("--against", type=Path, help="the original of splats that were pruned")
    parser.add_argument(
        "--quantise", type=float, nargs="+", default=[], help="factors of svrgs convert --quantise"
    )
    parser.add_argument(
        "--sh-degree", type=int, nargs="+", default=[], help="degrees of svrgs convert --sh-degree"
    )
    parser.add_argument("--others", action="store_true", help="files by other programs, too")
    parser.add_argument("--out", type=Path, help="file to append the tables to")
    parser.add_argument("--data", type=Path, help="dataset whose photographs judge")
    words = parser.parse_args()
    dataset = dataset_of(DatasetOptions(data=words.data)) if words.data else None
    cameras = dataset.training_cameras if dataset else []
    wanted = kinds(words.quantise, words.sh_degree, bool(cameras))
    wanted += [Kind(suffix, program=program) for program, suffix in others() if words.others]
    for path in words.splats:
        scene = load_scene(path)
        if dataset:
            judge = against_photographs(dataset)
        else:
            judge = against_scene(load_scene(words.against) if words.against else scene)
        with tempfile.TemporaryDirectory() as folder:
            table = "\n".join(
                [
                    f"\n### {path.stem}, {scene.count:,} Gaussians, SH degree {scene.sh_degree}\n",
                    HEAD.format("LPIPS" if dataset else "FLIP"),
                    *rows(scene, judge, wanted, cameras, Path(folder)),
                ]
            )
        if words.out:
            with open(words.out, "a", encoding="utf-8") as file:
                file.write(table + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
