"""Writes what is left of a divided scene, and measures it."""

from __future__ import annotations

import contextlib
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

from ...files import streamed_sog
from ...files.memory_mapped import mapped_scene
from ...files.reading import MAX_IN_PARTS
from ...files.registry import load_parts, size_on_disk, write_scene
from ...finetune.quality import best_share
from ...render.metrics.allowed_loss import loss_notes
from ...scene.camera import apart, evenly
from ..belonging import check_explained
from ..likeness import VIEWS, Likeness, PhotographLikeness
from .block_rasterizer import BlockRasterizer
from .divided import Divided, ProgressOf, divide, gathered, scene_of
from .folder import RESULT, measured_views
from .request import Request
from .tuning import CUT, mixed, tuned_blocks


def original_likeness(divided: Divided, progress_of: ProgressOf, lpips: Callable | None = None) -> Likeness:
    """Likeness to a divided scene in VIEWS views that are not scored and do not decide. lpips: as for
    Likeness. Raises SplatError."""
    decide, measure = apart(measured_views(divided.folder), VIEWS)
    views = evenly(measure, VIEWS)
    return Likeness(divided, views, BlockRasterizer, progress_of=progress_of, others=decide, lpips=lpips)


def finish(divided: Divided, likeness: Likeness, out: Path, progress_of: ProgressOf) -> dict[str, Any]:
    """Writes what is left of a divided scene, and measures the output. The share of the fine-tuning that is
    used is the one with the highest PSNR.

    progress_of: takes the name of a step, and returns the function that reports its progress. Returns the
    JSON result. Raises SplatError.
    """
    facts = write_left(divided, likeness, out)
    written = divide(out, divided.folder / RESULT, progress=progress_of("read"))
    result = facts | _figures(written, likeness, out, size_on_disk(out))
    return result | {"notes": result_notes(likeness, result)}


def result_notes(likeness: Likeness, result: dict[str, Any]) -> list[str]:
    """What the user must know of the measured quality. Raises SplatError."""
    measured = result["psnr"] is not None
    return likeness.notes() + (loss_notes(result["psnr_values"], result["psnr"]) if measured else [])


def finish_learned(
    divided: Divided, likeness: PhotographLikeness, request: Request, out: Path, progress_of: ProgressOf
) -> dict[str, Any]:
    """finish() of what a method has decided on photographs, which are the measure. Raises SplatError."""
    dataset = likeness.dataset
    gathered(divided.folder / CUT, divided)
    result = finish(divided, likeness, out, progress_of)
    before = {**likeness.measured(divided), "ms_per_frame": None, **result["before"]}
    doubts = check_explained(divided, dataset, str(divided.source), True, BlockRasterizer())
    notes, options = [*dataset.notes, *doubts, *result["notes"]], request.options
    return result | {"method": options.method, "seed": options.seed, "before": before, "notes": notes}


def write_left(divided: Divided, likeness: Likeness, out: Path) -> dict[str, Any]:
    """Writes what is left of a divided scene. Returns the part of finish()'s result that is known before the
    output is read. Raises SplatError."""
    left, facts = _settled(divided, likeness)
    write_joined(left, out)
    before = {"count": divided.count, "bytes": divided.source_bytes}
    what = {"scene": str(divided.source), "method": "merge", "blocks": len(divided.blocks)}
    return what | facts | {"before": before}


def _figures(written: Divided, likeness: Likeness, out: Path, size: int) -> dict[str, Any]:
    """The part of finish()'s result that comes from the output. written: the output, divided again. size: of
    the output, bytes."""
    measured = likeness.measured(written)
    figures = {name: measured[name] for name in ("psnr", "ssim", "lpips", "flip")}
    return {"out": str(out), **figures, "after": {"count": written.count, "bytes": size}}


def _settled(divided: Divided, likeness: Likeness) -> tuple[Divided, dict[str, float | None]]:
    """What is left, tuned as far as that does good; and its PSNR in dB: psnr_merged before it was tuned
    (None: it was not), psnr_values now. Both None without views."""
    left, tuned = Divided.read(divided.folder / CUT), tuned_blocks(divided)
    psnr_of = lambda scene: likeness.psnr(scene) if likeness.views else None
    merged = psnr_of(left)
    if not tuned:
        return left, {"psnr_merged": None, "tuned_share": 0.0, "psnr_values": merged}
    quality = lambda share: likeness.deciding.psnr(mixed(divided, tuned, share))
    share = best_share(quality) if likeness.deciding.views else 1.0
    best = mixed(divided, tuned, share)
    return best, {"psnr_merged": merged, "tuned_share": share, "psnr_values": psnr_of(best)}


def write_joined(divided: Divided, out: Path):
    """Writes all blocks, one after the other, in the format of the output. Raises SplatError."""
    with mapped_scene((scene_of(divided, block) for block in divided.blocks), out) as scene:
        write_scene(out, scene)


def join_levels(
    divided: Divided, likeness: Likeness, files: Sequence[Path], out: Path, progress_of: ProgressOf
) -> list[dict[str, Any]]:
    """Writes levels of detail as one streamed SOG, and measures each. files: their PLYs, the finest one
    first. Returns for each the part of finish()'s result that comes from the output. Raises SplatError."""
    with contextlib.ExitStack() as stack:
        levels = [stack.enter_context(mapped_scene(load_parts(path), out)) for path in files]
        streamed_sog.write_levels(out, levels)
    results = []
    for level in range(len(files)):
        read = partial(streamed_sog.read_level, level=level, max_count=MAX_IN_PARTS)
        written = divide(out, divided.folder / RESULT, progress=progress_of("read"), read=read)
        results.append(_figures(written, likeness, out, streamed_sog.level_bytes(out, level)))
    return results
