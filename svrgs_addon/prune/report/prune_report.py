"""The report of a pruning job: its figures, its curves, and pictures of a few views."""

from __future__ import annotations

import platform
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from ... import __version__
from ...files.images import to_float
from ...files.registry import load_scene
from ...finetune.run import Run
from ...native import library
from ...native.rasterizer import Rasterizer
from ...render.metrics import psnr
from ...render.metrics.evaluate import (
    Renderable,
    Renderer,
    frame_milliseconds,
    picture_options,
    rounded_to_8_bits,
)
from ...render.metrics.worst import Worst
from ...scene.camera import spaced
from ...scene.gaussians import Scene
from ...system import memory
from ...system.memory_limits import peak
from ...views.dataset import Dataset
from ...views.rendered import RenderedDataset
from .line_chart import Series
from .page import Phase, Report, View, write_report
from .swing import swing

# fields of a report that a result has under the same name
OF_RESULT = (
    "before", "after", "notes", "method", "lambda_f", "seconds", "iterations_per_second", "peak_memory_bytes",
    "seed",
)  # fmt: skip
REPORT_VIEWS = 3  # number of views with pictures
Opens = Callable[[Path, str, Callable[[int], int]], AbstractContextManager[tuple[Renderable, Renderer]]]


def write_prune_report(
    folder: Path,
    before: list,
    after: Scene,
    dataset: Dataset,
    run: Run,
    result: dict,
    lpips_missing: str,
    worst: Worst | None,
):
    """Writes folder/index.html. before: report_pictures() of the source scene; after: the pruned scene;
    result: the JSON result of the job; lpips_missing: why LPIPS was not measured; worst: where the pruned
    scene differs most. Raises SceneError if it cannot be written."""
    source = load_scene(Path(result["scene"]))
    figures, notes = timed_in_turn((source, after), (result["before"], result["after"]), dataset)
    seen_from = dataset.cameras[report_indices(dataset)[0]]
    swung = swing((source, after), seen_from, dataset.background)
    del source
    views = [*report_views(before, report_pictures(after, dataset, Rasterizer()), dataset)]
    if worst is not None:
        x, y, width, height = worst.square
        where = f"{worst.view}, {width} × {height} pixels at {x}, {y}"
        title = f"{where}: where it differs most, FLIP {worst.square_flip:.3f}"
        views.append(View(title, worst.original, worst.picture))
    timed = result | {"before": figures[0], "after": figures[1], "notes": [*result["notes"], *notes]}
    _write(
        folder,
        timed,
        views,
        lpips_missing,
        phases=_phases(run, result["seconds_by_phase"]),
        curves=_series(run),
        swing=swung,
        files=(str(result["scene"]), str(result["out"])),
    )


def write_report_of_files(folder: Path, dataset: Dataset, result: dict, opened: Opens, lpips_missing: str):
    """write_prune_report() of a job by blocks, from its files; without curves. result: its JSON result.
    opened: opens a scene to render it, as blocks.block_rasterizer.opened() does. lpips_missing: why LPIPS was
    not measured. Raises SplatError."""
    shown = [dataset.cameras[i] for i in report_indices(dataset)]
    width, height = max(camera.width for camera in shown), max(camera.height for camera in shown)
    needed, pictures = lambda count: memory.rendering(count, width, height), []
    for path in (result["scene"], result["out"]):
        with opened(Path(path), "rendering", needed) as (scene, rasterizer):
            pictures.append(report_pictures(scene, dataset, rasterizer))
    before, after = pictures
    views = report_views(before, after, dataset)
    _write(folder, result | {"peak_memory_bytes": peak()}, views, lpips_missing)


def _write(folder: Path, result: dict, views: Iterable[View], lpips_missing: str, **more: Any):
    """more: further fields of the report."""
    facts = {field: result[field] for field in OF_RESULT if field in result}
    page = Report(
        scene=Path(result["scene"]).stem,
        lpips_missing=lpips_missing,
        versions=_versions(),
        views=tuple(views),
        **facts | more,
    )
    write_report(folder, page)


def _versions() -> dict[str, str]:
    return {
        "SVR-GS": __version__,
        "Python": platform.python_version(),
        "NumPy": np.__version__,
        "SIMD": Rasterizer().level,
    }


def _phases(run: Run, seconds_by_phase: dict[str, float]) -> tuple[Phase, ...]:
    starts, start = {}, 0
    for phase in run.plan.phases:
        starts[phase.name] = start
        start += phase.steps
    return tuple(Phase(name, seconds, starts.get(name)) for name, seconds in seconds_by_phase.items())


def _series(run: Run) -> tuple[Series, ...]:
    curves = run.curves
    if not curves.iteration:
        return ()
    count = Series("Gaussians", curves.iteration, curves.count, from_zero=True)
    quality = Series("PSNR", curves.iteration, curves.psnr, "dB")
    measured = any(value is not None for value in curves.psnr)
    return (count, *([quality] if measured else []), Series("Loss", curves.iteration, curves.loss))


def report_indices(dataset: Dataset) -> list[int]:
    """Indices of a few test views, spread over the dataset; of training views if there are no test views."""
    return spaced(dataset.test_indices or dataset.train_indices, REPORT_VIEWS)


def timed_in_turn(
    scenes: Sequence[Renderable], figures: Sequence[dict], dataset: Dataset
) -> tuple[list[dict], list[str]]:
    """The figures of the scenes with the time per frame, measured in turn in the views of the report, and a
    sentence on how."""
    cameras = [dataset.cameras[i] for i in report_indices(dataset)]
    times = frame_milliseconds(scenes, cameras)
    note = (
        f"time per frame: medians of rendering both splats in turn, in {len(cameras)} views of"
        f" {cameras[0].width} x {cameras[0].height} pixels, with {library.threads()} threads of this machine"
    )
    return [one | {"ms_per_frame": ms} for one, ms in zip(figures, times, strict=True)], [note]


def report_pictures(
    scene: Renderable, dataset: Dataset, rasterizer: Renderer
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Colours (H, W, 3), clamped to 0..1 and rounded to 8 bits, and spatial mask (H, W) of each view of the
    report."""
    options = picture_options(scene, dataset.background, "svr")
    renders = [
        rasterizer.forward(scene, dataset.cameras[i], options, outputs=("rgb", "mask"))
        for i in report_indices(dataset)
    ]
    return [(rounded_to_8_bits(images["rgb"]), images["mask"]) for images in renders]


def report_views(before: list, after: list, dataset: Dataset) -> Iterator[View]:
    """The views of the report, from report_pictures() of both scenes. Pictures of the scene itself are not
    shown as photographs."""
    own = isinstance(dataset, RenderedDataset)
    pairs = zip(report_indices(dataset), before, after, strict=True)
    for i, (rgb_before, mask_before), (rgb_after, mask_after) in pairs:
        photo, share = to_float(dataset.image(i)), dataset.cameras[i].valid_share
        psnr_before = None if own else psnr(rgb_before, photo, share)
        yield View(
            dataset.cameras[i].name,
            rgb_before,
            rgb_after,
            None if own else photo,
            mask_before,
            mask_after,
            psnr_before,
            psnr(rgb_after, photo, share),
        )
