"""The datasets of an experiment, with smaller photographs if asked for."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import OpenImageIO as oiio

ROOT = Path(__file__).resolve().parents[1]
# name of a dataset: scene of tests/demo_scene
GENERATED = {"demo": "plaza", "room": "room", "portrait": "portrait", "row": "row"}


def prepared(name: str, folder: Path | None, work: Path, shrink: int) -> list[str]:
    """The flags --data and --images of a scene. folder None: one of GENERATED, which is made in `work`.
    shrink: reduction per side."""
    work.mkdir(parents=True, exist_ok=True)
    if folder is None:
        if name not in GENERATED:
            sys.exit(
                f"scene '{name}' has no folder: give --scene {name}=DIR, or one of the generated scenes:"
                f" {', '.join(GENERATED)}"
            )
        folder = work / "dataset"
        subprocess.run(
            [sys.executable, "-m", "tests.demo_scene", str(folder), "--scene", GENERATED[name]],
            cwd=ROOT,
            check=True,
            stdout=sys.stderr,
        )
    if shrink == 1:
        return ["--data", str(folder)]
    images = work / f"images_{shrink}"
    for source in sorted((folder / "images").rglob("*")):
        smaller = images / source.relative_to(folder / "images")
        if source.is_file() and not smaller.exists():
            shrunk(source, smaller, shrink)
    return ["--data", str(folder), "--images", str(images)]


def shrunk(source: Path, target: Path, shrink: int):
    """Writes a photograph in which `shrink` x `shrink` pixels are averaged into one."""
    image = oiio.ImageBuf(str(source))
    spec = image.spec()
    region = oiio.ROI(0, spec.width // shrink, 0, spec.height // shrink, 0, 1, 0, spec.nchannels)
    target.parent.mkdir(parents=True, exist_ok=True)
    small = oiio.ImageBufAlgo.resize(image, filtername="box", roi=region)
    small.specmod().attribute("compression", "jpeg:97")
    if not small.write(str(target)):
        sys.exit(f"{target}: {small.geterror()}")
