"""Runs inside Blender as a module, started by ../test_extension.py: the installed extension, and a scene
without anything in it."""

from __future__ import annotations

import contextlib
import os
import re
import shutil
from dataclasses import dataclass
from pathlib import Path

import bpy
import numpy as np
import pytest
from extension import DATA, PACKAGE, part
from job_helpers import SHORT, end_all, follow, set_up

from svrgs_bench import scenes

KINDS = ("objects", "meshes", "pointclouds", "cameras", "images", "collections")
# of the installed extension: jobs of tiny splats then take a fraction of the time
SMALLER = {
    "svrgs_addon/prune/job_views.py": {"QUICK_SIDE": 128},
    "svrgs_addon/views/rig/place.py": {
        "FIRST": 12, "SECOND": 4, "MIN_CHOSEN": 8, "MAX_CHOSEN": 12, "USUAL_VIEWS": 16, "OUTSIDE": 8,
    },
    "svrgs_addon/views/rig/viewpoints.py": {"SMALLEST": 128, "LARGEST": 128},
}  # fmt: skip


@pytest.fixture(scope="session", autouse=True)
def installed() -> Path:
    """Folder of the extension, installed and enabled by Blender itself. Its jobs have fewer and smaller views
    than those of users."""
    bpy.ops.extensions.package_install_files(filepath=os.environ["SVRGS_TEST_ZIP"], repo="user_default")
    folder = Path(bpy.utils.user_resource("EXTENSIONS", path="user_default/svrgs"))
    for file, limits in SMALLER.items():
        text = (folder / file).read_text()
        for name, value in limits.items():
            assert re.search(rf"^(\w+, )*{name}(, \w+)* = ", text, re.MULTILINE), (file, name)
            text += f"{name} = {value}\n"
        (folder / file).write_text(text)
    bpy.ops.preferences.addon_enable(module=PACKAGE)
    return folder


@pytest.fixture(autouse=True)
def empty():
    for kind in KINDS:
        bpy.data.batch_remove(list(getattr(bpy.data, kind)))
    settings = bpy.context.scene.svrgs_prune
    for name in settings.bl_rna.properties.keys():
        if name not in ("rna_type", "name", "amount", "method_choice"):
            settings.property_unset(name)
    part("operators.io.export_levels").forget()


@pytest.fixture
def bridge():
    return part("operators.data.splat_object")


@pytest.fixture
def ply():
    """Reads and writes PLY files."""
    return part("svrgs_addon.files.ply")


@dataclass(frozen=True)
class Views:
    """Cameras as COLMAP has them, in name order."""

    viewmats: np.ndarray  # (V, 4, 4)
    Ks: np.ndarray  # (V, 3, 3)
    sizes: np.ndarray  # (V, 2)
    names: list[str]
    points: np.ndarray  # (P, 3)

    def pixels(self, view: int) -> np.ndarray:
        """(P, 2) where the view shows the points; NaN behind it."""
        x = self.points.astype(np.float64) @ self.viewmats[view, :3, :3].T + self.viewmats[view, :3, 3]
        px = x @ self.Ks[view].T
        return np.where(x[:, 2:] > 0.01, px[:, :2] / px[:, 2:], np.nan)


@pytest.fixture(params=["tiny", "varied"])
def dataset(request) -> tuple[Path, Views]:
    with np.load(DATA / f"{request.param}.npz") as stored:
        return DATA / request.param, Views(
            stored["viewmats"],
            stored["Ks"],
            stored["sizes"],
            [str(n) for n in stored["names"]],
            stored["points"],
        )


@pytest.fixture
def make_scene():
    """Scenes as a file may hold them: not normalised, extreme, with further columns of every type."""
    Scene = part("svrgs_addon.scene.gaussians").Scene

    def make(count: int = 500, degree: int = 3, further: bool = True):
        rng, K = np.random.default_rng(degree), (degree + 1) ** 2
        columns = {
            "nx": rng.normal(size=count).astype(np.float32), "label": rng.integers(0, 255,
            count).astype(np.uint8), "t": rng.normal(size=count),
            "id": rng.integers(0, 2**32, count, dtype=np.uint64).astype(np.uint32),
            "scale": rng.normal(size=count).astype(np.float32),
            "small": rng.integers(-128, 127, count).astype(np.int8), "far": rng.integers(-(2**31), 2**31,
            count).astype(np.int32),
            "x" * 80: rng.integers(-(2**15), 2**15, count).astype(np.int16),
        }  # fmt: skip
        logits = rng.normal(0, 10, count)
        logits[:3] = 0, 200, -200
        arrays = (
            rng.normal(size=(count, 3)),
            rng.normal(-4, 4, (count, 3)),
            rng.normal(size=(count, 4)),
            logits,
            rng.normal(size=(count, K, 3)),
        )
        means, log_scales, quats, logits, sh = (np.ascontiguousarray(a, np.float32) for a in arrays)
        return Scene(
            means,
            log_scales,
            quats,
            logits,
            sh,
            True,
            columns if further else {},
            ("made by hand", "SplatRenderMode: mip"),
        )

    return make


# --- views


@pytest.fixture
def stage():
    """Blender as a user finds it, with the engine chosen and colours as they are."""
    scene = bpy.context.scene
    render = scene.render
    render.engine, scene.view_settings.view_transform = "SVRGS", "Standard"
    render.image_settings.file_format, render.image_settings.color_mode = "PNG", "RGBA"
    render.image_settings.color_depth = "8"
    render.resolution_x, render.resolution_y, render.resolution_percentage = 101, 61, 100
    render.pixel_aspect_x = 1
    render.dither_intensity = 1.0  # as Blender has it
    render.use_border = render.use_crop_to_border = render.film_transparent = False
    render.border_min_x, render.border_max_x, render.border_min_y, render.border_max_y = 0.23, 0.71, 0.1, 0.55
    looking = scene.svrgs_view
    looking.background, looking.original, looking.pruned, looking.compare_camera = (0, 0, 0), None, None, None
    return scene


@pytest.fixture
def gaussians():
    return scenes.room(3000)


@pytest.fixture
def room(bridge, gaussians, stage):
    obj = bridge.object_from_scene("room", gaussians, stage.collection)
    bpy.context.view_layer.objects.active = obj
    return obj


@pytest.fixture
def camera(stage):
    data = bpy.data.cameras.new("camera")
    obj = stage.camera = bpy.data.objects.new("camera", data)
    stage.collection.objects.link(obj)
    obj.location, obj.rotation_euler = (0.5, -6, 0.7), (1.5, 0.1, 0.2)
    data.lens, data.shift_x, data.shift_y = 30, 0.1, -0.07
    bpy.context.view_layer.update()
    return obj


# --- jobs


@pytest.fixture
def watch():
    module = part("operators.jobs.job_watch")
    part("operators.jobs.job_list").forget()
    module.jobs.clear()  # of a test before, whose panel has found some
    yield module
    end_all(module)
    module.jobs.clear()


@pytest.fixture
def results():
    return part("operators.jobs.job_result")


@pytest.fixture
def splat(tmp_path):
    """The tiny splat, active, with settings for its dataset and a folder for its jobs."""
    bpy.ops.svrgs.import_ply(filepath=str(DATA / "tiny/scene.ply"))
    settings = bpy.context.scene.svrgs_prune
    settings.data, settings.folder = str(DATA / "tiny"), str(tmp_path / "jobs")
    return bpy.context.object


@pytest.fixture
def pruned(splat, watch, once):
    """(original, result) of a job that was run to its end."""
    set_up(SHORT)
    with once("pruned"):
        bpy.ops.svrgs.job_start()
        follow(watch, lambda: len(bpy.data.objects) == 2)
    (result,) = (obj for obj in bpy.data.objects if obj != splat)
    return splat, result


@pytest.fixture(scope="session")
def once(tmp_path_factory):
    """Context manager once(name): the first time, a job of its block runs to its end. After that, what its
    process wrote is there at once, and none is started."""
    files = tmp_path_factory.mktemp("once")

    @contextlib.contextmanager
    def run(name: str):
        process, recorded = part("svrgs_addon.jobs.job_process"), files / name

        class Ended(process.ProcessGroup):
            def __init__(self, command, **_):
                shutil.copytree(recorded, command[-1], dirs_exist_ok=True)
                self.stdin, self.returncode = None, 0

        with pytest.MonkeyPatch.context() as patch:
            if recorded.exists():
                patch.setattr(process, "ProcessGroup", Ended)
            yield
        (job,) = part("operators.jobs.job_watch").jobs.values()
        if not recorded.exists():
            shutil.copytree(job.folder.path, recorded)

    return run
