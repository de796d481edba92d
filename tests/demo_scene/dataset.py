"""Owns the dataset folder: the stamp that tells whether it is current, and its making.

A dataset is built in a temporary folder beside its place and renamed, so it is never half there.
"""

import hashlib
import importlib.util
import json
import shutil
import tempfile
from collections.abc import Callable
from contextlib import suppress
from dataclasses import asdict, dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from . import quiet

STAMP = "demo_scene.json"
NO_BLENDER = (
    "rendering the demo scene needs Blender as a Python module (bpy), which exists for Python 3.11 and 3.13 only; "
    "with one of these: make demo PYTHON=python3.11 VENV=.venv311"
)


@dataclass(frozen=True)
class Request:
    """What to render; equal requests to equal sources give equal bytes."""

    views: int = 60
    width: int = 360  # pixels; the height follows as 3/4 of it
    samples: int = 8  # per pixel
    points: int = 5000  # aimed at; those seen by one view only are dropped

    def __post_init__(self) -> None:
        if self.views < 2 or self.width < 16 or self.samples < 1 or self.points < 1:
            raise ValueError("needs at least 2 views, 16 pixels of width, 1 sample and 1 point")

    @property
    def height(self) -> int:
        return self.width * 3 // 4


def fingerprint(request: Request) -> str:
    """Hash of the generator's sources, the request and the version of Blender."""
    digest = hashlib.sha256(json.dumps(asdict(request), sort_keys=True).encode())
    for source in sorted(Path(__file__).parent.glob("*.py")):
        digest.update(source.read_bytes())
    try:
        digest.update(version("bpy").encode())
    except PackageNotFoundError:  # inside Blender itself, or no Blender at all
        pass
    return digest.hexdigest()


def read_stamp(out: Path) -> dict | None:
    """The stamp of a dataset, or None where there is none."""
    with suppress(OSError, ValueError):
        return json.loads((out / STAMP).read_text(encoding="utf-8"))
    return None


def is_current(out: Path, request: Request) -> bool:
    stamp = read_stamp(out)
    return stamp is not None and stamp.get("fingerprint") == fingerprint(request)


def ensure(out: Path, request: Request) -> bool:
    """Make the dataset at `out` unless it is there already. True if it was made now."""
    out = out.absolute()
    if is_current(out, request):
        return False
    if out.exists() and read_stamp(out) is None and (not out.is_dir() or any(out.iterdir())):
        raise ValueError(f"{out} is not a demo dataset and is left untouched")
    out.parent.mkdir(parents=True, exist_ok=True)
    work = Path(tempfile.mkdtemp(prefix=f".{out.name}-", dir=out.parent))
    try:
        fresh, old = work / "fresh", work / "old"
        _generate(fresh, request)
        if is_current(out, request):  # another process was faster
            return False
        if out.exists():
            out.rename(old)
        fresh.rename(out)
    finally:
        shutil.rmtree(work, ignore_errors=True)
    return True


def _generate(folder: Path, request: Request) -> None:
    if importlib.util.find_spec("bpy") is None:
        raise ImportError(NO_BLENDER)
    folder.mkdir()
    with quiet.captured(folder.parent / "blender.log") as terminal:
        _render(folder, request, quiet.progress(terminal, "rendering the demo scene"))


def _render(folder: Path, request: Request, progress: Callable[[int, int], None]) -> None:
    # Imported here so that finding a dataset up to date does not start Blender.
    import bpy  # noqa: F401  bmesh and mathutils can be imported only after it

    from demo_scene import build, colmap, points, render, views

    camera = views.Intrinsics.for_size(request.width, request.height)
    poses = views.rings(request.views)
    (folder / "images").mkdir()
    scene = build.build_scene()
    images = render.render_views(scene, camera, poses, folder / "images", request.samples, progress)
    cloud = points.sample(build.world_surface(scene), camera, poses, images, request.points)
    colmap.write_model(folder / "sparse" / "0", camera, poses, cloud)
    stamp = {
        "fingerprint": fingerprint(request),
        "request": asdict(request),
        "points": len(cloud.xyz),
        "marker": build.MARKER,
    }
    (folder / STAMP).write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")
