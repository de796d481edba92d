"""Runs one train or prune job and measures where its time and memory go. It reads a request from stdin and
writes an answer to stdout, as JSON.

Request: data, out, kind ("train" or "prune"), iterations, recovery, seed, profile (bool); scene (prune
only); settings to change: "phase", by name those of the first phase (settings.Phase), and "run", by name
those of the run (settings.Settings).
"""

from __future__ import annotations

import cProfile
import functools
import json
import pstats
import sys
import time
from dataclasses import replace
from pathlib import Path

PACKAGE = str(Path(__file__).resolve().parents[1] / "svrgs_addon")
STAGES_SHOWN = 12  # functions in the answer, those with the most time
LIBRARY_DEPTH = 6  # calls inside other packages are followed to this depth


def time_native_calls() -> dict[str, float]:
    """Starts to time calls of the native library. Returns a dict that gets the seconds of each function."""

    from svrgs_addon.native import rasterizer

    seconds: dict[str, float] = {}
    call = rasterizer._call

    def timed_native_call(name: str, *arguments):
        started = time.perf_counter()
        try:
            return call(name, *arguments)
        finally:
            seconds[name] = seconds.get(name, 0.0) + time.perf_counter() - started

    rasterizer._call = timed_native_call
    return seconds


def stages(profile: cProfile.Profile) -> dict[str, float]:
    """Seconds of each function of the package, without native calls: its own time, and its share of the time
    of other packages that it calls."""
    # (file, line, name): calls, primitive calls, own time, time with callees, {caller: the same four}
    found = pstats.Stats(profile).stats
    ours = {key for key in found if key[0].startswith(PACKAGE)}
    native = {key for key in found if key[2] in ("timed_native_call", "call_library")}
    # caller: {function of another package: the caller's share of its time}
    below: dict[tuple, dict[tuple, float]] = {key: {} for key in found}
    for key in found.keys() - ours - native:
        callers = found[key][4]
        total = sum(times[3] for times in callers.values()) or 1.0
        for caller, times in callers.items():
            below[caller][key] = times[3] / total

    @functools.cache
    def seconds(key: tuple, depth: int) -> float:
        return found[key][2] + sum(
            share * seconds(child, depth - 1) for child, share in below[key].items() if depth
        )

    named = {
        f"{Path(file).stem}.{name}": seconds((file, line, name), LIBRARY_DEPTH)
        for file, line, name in ours - native
    }
    return dict(sorted(named.items(), key=lambda item: -item[1])[:STAGES_SHOWN])


def settings_of(request: dict):
    """The plan of the job, with the settings that the request changes."""
    from svrgs_addon.finetune.methods import method_named
    from svrgs_addon.finetune.plan import prune_plan, train_plan
    from svrgs_addon.finetune.settings import Densify

    iterations, recovery, seed = request["iterations"], request["recovery"], request["seed"]
    if request["kind"] == "train":
        settings = train_plan(
            method_named("3dgs"),
            iterations,
            recovery,
            seed=seed,
            densify=Densify(until=int(0.6 * iterations)),
        )
    else:
        settings = prune_plan(method_named("svr"), iterations, recovery, seed=seed, min_contribution=0.02)
    first, *rest = settings.phases
    return replace(settings, phases=(replace(first, **request["phase"]), *rest), **request["run"])


def run_job(request: dict) -> dict:
    """The job's result, with further figures of memory and time."""
    from svrgs_addon.prune.context import JobContext
    from svrgs_addon.prune.pipeline import run
    from svrgs_addon.prune.recipes.fine_tuned import FineTuned
    from svrgs_addon.prune.recipes.trained import Trained
    from svrgs_addon.system.memory_limits import peak
    from svrgs_addon.views.dataset import load_dataset

    native = time_native_calls()
    dataset = load_dataset(Path(request["data"]), need_points=request["kind"] == "train")
    base, counts = peak(), [0]
    options = JobContext(Path(request["out"]), observe=lambda progress: counts.append(progress.count))
    profile = cProfile.Profile()
    if request["profile"]:
        profile.enable()
    if request["kind"] == "train":
        result = run(Trained(settings_of(request), options, lambda: dataset))
    else:
        scene = Path(request["scene"])
        result = run(FineTuned(scene, settings_of(request), options, lambda _: dataset))
    profile.disable()
    result |= {
        "base_memory_bytes": base,
        "image_bytes": sum(image.nbytes for image in dataset._cache.values()),
        "largest_count": max(*counts, result.get("before", result)["count"]),
        "native_seconds": dict(sorted(native.items(), key=lambda item: -item[1])),
        "stage_seconds": stages(profile) if request["profile"] else {},
    }
    return result


def main():
    answer = run_job(json.load(sys.stdin))
    from svrgs_addon.system.exit_status import plain

    print(json.dumps(plain(answer)))


if __name__ == "__main__":
    main()
