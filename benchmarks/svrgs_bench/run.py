"""`svrgs bench`: runs the chosen measurements in order and collects their result."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from svrgs_addon.files.atomic import check_writable, write_bytes
from svrgs_addon.native import library

from .accuracy import error
from .cases import chosen_cases, room_case
from .cores import measure_cores
from .interactive import measure_interactive, measure_viewport
from .knobs import measure_knobs
from .measure import measure, peaks_of
from .plots import charts
from .scaling import measure_scaling
from .skips import measure_skips
from .stress import measure_stress, stress_charts

REPEAT, QUICK_REPEAT = 9, 3


def bench(options: argparse.Namespace) -> dict:
    """The JSON result: machine, cases, and the chosen ones of knobs, skips, scaling, cores, interactive and
    viewport. Charts go to options.plots. Raises SplatError, NativeError."""
    if options.plots:
        check_writable(options.plots / "plot.svg")
    if options.stress:
        return _stress(options)
    cases = chosen_cases(options)
    repeat = options.repeat or (QUICK_REPEAT if options.quick else REPEAT)
    library.set_threads(options.threads)
    most, level = library.threads(), library.best_level()
    thread_counts = sorted({1, most})
    machine = {
        "cores": most,
        "simd": level,
        "simd_levels": library.supported_levels(),
        "peaks": {str(threads): peak for threads, peak in peaks_of(level, thread_counts).items()},
    }
    result: dict = {"machine": machine, "cases": []}
    for case in cases:
        progress("{scene}: {count:,} Gaussians, SH {sh_degree}, {width} x {height}".format(**case.facts))
        library.set_threads(most)
        result["cases"] += measure(case, thread_counts, error(case), repeat)
    library.set_threads(most)
    if options.knobs or options.plots:
        result["knobs"] = measure_knobs(room_case(), repeat, progress)
    if options.skips or options.plots:
        result["skips"] = measure_skips(room_case(), repeat, progress)
    if options.scaling:
        result["scaling"] = measure_scaling(repeat, progress)
    if options.cores:
        result["cores"] = measure_cores(repeat, progress)
    if options.interactive:
        result["interactive"] = measure_interactive(progress)
        result["viewport"] = measure_viewport(progress)
    if options.plots:
        result["plots"] = _write(options.plots, charts(result))
    return result


def _stress(options: argparse.Namespace) -> dict:
    """The result of --stress, which measures no time."""
    library.set_threads(options.threads)
    case = next(chosen_cases(options)) if options.scene else None
    result: dict = {"stress": measure_stress(progress, case=case)}
    if options.plots:
        result["plots"] = _write(options.plots, stress_charts(result["stress"]))
    return result


def progress(sentence: str):
    """Prints progress on stderr; stdout is for the result."""
    print(f"bench: {sentence}", file=sys.stderr, flush=True)


def _write(folder: Path, documents: dict[str, str]) -> list[str]:
    paths = []
    for name, document in documents.items():
        paths.append(folder / f"{name}.svg")
        write_bytes(paths[-1], document.encode())
    return [str(path) for path in paths]
