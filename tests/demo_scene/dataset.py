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
from .scenes import SCENES, Kind

STAMP = "demo_scene.json"
NO_BLENDER = (
    "rendering the demo scene needs Blender as a Python module (bpy), which exists for Python 3.11 and 3.13"
    " only; with one of these: make demo PYTHON=python3.11 VENV=.venv311"
)


@dataclass(frozen=True)
class Request:
    """What to render; equal requests to equal sources give equal bytes."""

    scene: str
    views: int
    width: int  # pixels; the height follows from the scene's format
    samples: int  # per pixel
    points: int  # aimed at; those seen by one view only are dropped

    def __post_init__(self) -> None:
        if self.views < 2 or self.width < 16 or self.samples < 1 or self.points < 1:
            raise ValueError("needs at least 2 views, 16 pixels of width, 1 sample and 1 point")

    @classmethod
    def of(cls, scene: str, **changes: int | None) -> "Request":
        """The scene's defaults, and `changes` that are not None."""
        defaults = {name: getattr(SCENES[scene], name) for name in ("views", "width", "samples", "points")}
        given = {name: value for name, value in changes.items() if value is not None}
        return cls(scene, **defaults | given)

    @property
    def kind(self) -> Kind:
        return SCENES[self.scene]

    @property
    def height(self) -> int:
        return self.width * self.kind.aspect[1] // self.kind.aspect[0]


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
    import bpy  # bmesh and mathutils can be imported only after it

    from demo_scene import capture, colmap, points, render, views

    model = importlib.import_module(f"demo_scene.{request.scene}")
    camera = views.Intrinsics(request.width, request.height, request.kind.focal * request.width)
    poses = model.cameras(request.views)
    gains = capture.gains(request.views) if request.kind.phone else None
    develop = None if gains is None else lambda index, light: capture.photograph(light, gains[index], index)
    (folder / "images").mkdir()
    bpy.ops.wm.read_factory_settings(use_empty=True)
    scene = bpy.context.scene
    model.build(scene)
    images = render.render_views(scene, camera, poses, folder / "images", request.samples, progress, develop)
    cloud = points.sample(points.world_surface(scene), camera, poses, images, request.points)
    colmap.write_model(folder / "sparse" / "0", camera, poses, cloud)
    stamp = {
        "fingerprint": fingerprint(request),
        "request": asdict(request),
        "points": len(cloud.xyz),
        **getattr(model, "NOTES", {}),
        **({} if gains is None else {"gains": gains.tolist()}),
    }
    (folder / STAMP).write_text(json.dumps(stamp, indent=1) + "\n", encoding="utf-8")
