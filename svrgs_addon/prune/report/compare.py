"""`svrgs compare`: two scenes from the same cameras, as PNG files and as an HTML page."""

from __future__ import annotations

import functools
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from ... import __version__
from ...files.images import to_bytes, write_image
from ...files.registry import size_on_disk
from ...native.rasterizer import Rasterizer
from ...render.metrics import load_lpips
from ...render.metrics.evaluate import Renderable, Renderer, evaluate, refuse_unseen
from ...render.metrics.lpips import measurable
from ...scene.camera import refuse_same_stems, view_stem
from ...system import memory
from ...system.errors import SceneError
from ...system.file_names import real
from ...views.dataset import Dataset, in_training_views
from ...views.rendered import RenderedDataset
from ..belonging import leave_out_empty_tests
from .page import MASK_PERCENTILE, Report, View, write_report
from .pictures import difference_image, mask_to_rgb
from .prune_report import Opens, report_indices, report_pictures, report_views, timed_in_turn
from .swing import swing


def compare(
    a: Path, b: Path, dataset: Dataset, out: Path, opened: Opens, lpips_weights: Path | None = None
) -> dict:
    """Writes index.html and, for each of a few test views, one PNG: A | B | difference | spatial mask of A |
    spatial mask of B.

    dataset: if it has no photographs, pictures of A take their place, and 'a' has no figures of quality.
    opened: opens a scene to render it, as blocks.block_rasterizer.opened() does. Returns the JSON result: 'a'
    and 'b' with the figures of `svrgs eval`, 'report' (the page), 'pictures' (the files), 'notes' of the
    dataset. Raises SplatError.
    """
    shown = [dataset.cameras[i] for i in report_indices(dataset)]
    others = "photographs another name, in the COLMAP model too"
    refuse_same_stems(shown, f"give one of the {others if dataset.photos else 'cameras another name'}")
    _refuse_photographs(dataset, [_picture(out, camera.name) for camera in shown])
    cameras = [dataset.cameras[i] for i in dataset.test_indices or dataset.train_indices]
    lpips, missing = measurable(load_lpips(lpips_weights), cameras, lpips_weights is not None)
    needed = functools.partial(
        memory.comparing,
        cameras=cameras,
        shown=shown,
        kept_photographs=dataset.memory_budget,
        lpips=lpips is not None,
    )
    figures, renders, timing, swung = list[dict](), [], list[str](), None
    with opened(a, "comparing", needed) as first, opened(b, "comparing", needed) as second:
        opened_scenes = ((a, *first), (b, *second))
        for path, scene, _ in opened_scenes:
            refuse_unseen(scene, dataset.cameras, str(path))
        notes, own = [*dataset.notes, *in_training_views(dataset)], not dataset.photos
        if own:
            dataset = _of_pictures(dataset, *first)
            notes += leave_out_empty_tests(dataset)
        views = dataset.test_indices or ([] if own else dataset.train_indices)
        for path, scene, rasterizer in opened_scenes:
            quality = (
                {"count": scene.count}
                if own and not figures
                else evaluate(scene, dataset, views, rasterizer, lpips)
            )
            figures.append({**quality, "bytes": size_on_disk(path)})
            renders.append(report_pictures(scene, dataset, rasterizer))
        if all(isinstance(rasterizer, Rasterizer) for _, _, rasterizer in opened_scenes):
            figures, timing = timed_in_turn((first[0], second[0]), figures, dataset)
            swung = swing((first[0], second[0]), shown[0], dataset.background)
        pictures = list(report_views(renders[0], renders[1], dataset))
    files = [_save(out, view) for view in pictures]
    page = Report(
        scene=f"{a.name} and {b.name}", before=figures[0], after=figures[1], names=(a.name, b.name),
        lpips_missing=missing, notes=[*notes, *timing], views=tuple(pictures),
        versions={"SVR-GS": __version__}, swing=swung, files=(str(a), str(b)),
    )  # fmt: skip
    path = write_report(out, page)
    facts = {"report": str(path), "pictures": [str(file) for file in files], "notes": notes}
    return {"a": figures[0], "b": figures[1]} | facts


def _of_pictures(views: Dataset, scene: Renderable, rasterizer: Renderer) -> RenderedDataset:
    """The same views with pictures of the scene as photographs."""
    return RenderedDataset.of(
        scene,
        views.training_cameras,
        [views.cameras[k] for k in views.test_indices],
        background=views.background,
        memory_budget=views.memory_budget,
        notes=views.notes,
        rasterizer=rasterizer,
    )


def _refuse_photographs(dataset: Dataset, pictures: Sequence[Path]):
    photographs = {real(photo.path) for photo in dataset.photos}
    if found := [picture for picture in pictures if real(picture) in photographs]:
        raise SceneError(f"{found[0]}: is a photograph, and would be replaced; name another folder")


def _picture(out: Path, view: str) -> Path:
    """The file of the pictures of a view."""
    return out / f"{view_stem(view)}.png"


def _save(out: Path, view: View) -> Path:
    assert view.mask_before is not None and view.mask_after is not None
    top = max(float(np.percentile(view.mask_before, MASK_PERCENTILE)), 1e-6)
    parts = [to_bytes(view.before), to_bytes(view.after), difference_image(view.before, view.after)]
    parts += [mask_to_rgb(mask, top) for mask in (view.mask_before, view.mask_after)]
    path = _picture(out, view.name)
    write_image(path, np.concatenate(parts, axis=1))
    return path
