"""Times, work counts and floors (lower bounds of the time) of one case."""

from __future__ import annotations

import numpy as np

from svrgs_addon.native import library

from .cases import Case
from .floors import row_lines, stage_floors
from .timing import rounds, seconds, summary
from .trial import Trial

# counts that are larger if F counts every hit of a ray
FULL_WALK = ("used_pairs", "blocks", "hit_blocks", "hits")
PEAK_READINGS = 3  # readings of a peak; the best one counts


def measure(case: Case, thread_counts: list[int], error: dict, repeat: int) -> list[dict]:
    """One item of the result's `cases` per thread count. error: the errors of this case. Peaks are measured
    in each round, because the speed of a machine changes over time."""
    trial = Trial(case)
    level, work, entries = trial.rasterizer.level, work_counts(trial), []
    for threads in thread_counts:
        library.set_threads(threads)
        peaks: list[dict] = []
        readings = rounds(lambda: _round(trial, peaks), repeat)  # noqa: B023
        floors = [stage_floors(work, case.facts, level, peak) for peak in peaks[-repeat:]]
        floor = {name: float(np.median([one[name] for one in floors])) for name in floors[0]}
        stages = {name: {**summary(readings[name]), "floor_ms": 1e3 * floor[name]} for name in floor}
        entries.append(
            {**case.facts, "threads": threads, "simd": level, "stages": stages, "work": work, "error": error}
        )
    return entries


def peaks_of(level: str, thread_counts: list[int]) -> dict[int, dict]:
    """The peaks of this machine: {threads: {fma: flop/s, read: bytes/s, update: bytes/s}}."""
    peaks = {}
    for threads in thread_counts:
        library.set_threads(threads)
        readings = [library.peaks(level) for _ in range(PEAK_READINGS)]
        peaks[threads] = {name: max(reading[name] for reading in readings) for name in readings[0]}
    return peaks


def work_counts(trial: Trial, disabled_skips=()) -> dict:
    """Work counts of the pass for colours; as NAME_full those with F to the end of each ray; and
    floors.row_lines of the visible Gaussians."""
    trial.forward("none", disabled_skips=disabled_skips)
    counts = trial.rasterizer.work(count_pixels=True)
    trial.forward(disabled_skips=disabled_skips)
    full = trial.rasterizer.work(count_pixels=True)
    lines = row_lines(trial.rasterizer.visible(), trial.case.facts["sh_degree"])
    return counts | {f"{name}_full": full[name] for name in FULL_WALK} | {"row_lines": lines}


def _round(trial: Trial, peaks: list[dict]) -> dict[str, float]:
    """Seconds of every stage, each run once. The peaks of the machine in this round are added to `peaks`."""
    peaks.append(library.peaks(trial.rasterizer.level))
    inside = trial.rasterizer.stage_seconds
    trial.forward("none")
    blend = inside()["blend"]
    trial.forward(full=False)
    mask_visible = inside()["blend"] - blend
    forward = seconds(trial.forward)
    first = inside()
    loss = seconds(trial.loss)
    backward = seconds(trial.backward)
    second = inside()
    ids, grads = trial.rasterizer.visible(), trial.backward()
    return {
        **{name: first[name] for name in ("project", "tiles", "sort")},
        "blend": blend,
        "mask": first["blend"] - blend,
        "mask_visible": mask_visible,
        "forward": forward,
        **{name: second[name] for name in ("raster_grads", "parameter_grads")},
        "backward": backward,
        "loss": loss,
        "adam": trial.adam(grads, ids),
        "step": seconds(trial.step),
    }
