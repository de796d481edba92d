"""The one loop: advances a run to its end, tells an observer, measures curves, stops and saves where asked."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..errors import Cancelled, SplatError
from .run import Run

CURVE_POINTS = 40


@dataclass
class Progress:
    """What an observer is told after each step."""

    iteration: int
    total: int
    phase: str
    label: str  # of the phase, for people
    count: int
    loss: float  # exponentially smoothed
    iterations_per_second: float
    seconds_left: float


def run_to_end(
    run: Run,
    observe: Callable[[Progress], None],  # called after each step
    stop: Callable[[], bool],
    checkpoint: Callable[[], object],
    measure: Callable[[], float | None],  # a PSNR for the curves
):
    """Advances until finished; the curves gain CURVE_POINTS points on the way. On stop(): checkpoint, then Cancelled. A checkpoint
    too where a photograph cannot be read any more."""
    total, begun, first, counted_from = run.settings.total, time.perf_counter(), run.iteration, run.iteration
    every = max(1, total // CURVE_POINTS)
    try:
        while not run.finished:
            phase, _ = run.phase()
            run.advance()
            if run.iteration % every == 0 or run.finished:
                _add_point(run, measure())
            rate = (run.iteration - counted_from) / (time.perf_counter() - begun)
            if run.iteration == first + 1:  # the first step also ranks Gaussians and fills caches: what follows is faster
                begun, counted_from = time.perf_counter(), run.iteration
            observe(Progress(run.iteration, total, phase.name, phase.label, run.model.count, run.loss, rate, (total - run.iteration) / rate))
            if stop() and not run.finished:
                checkpoint()
                raise Cancelled
    except SplatError:
        if run.whole and run.iteration > first:
            with contextlib.suppress(SplatError):
                checkpoint()
        raise
    finally:
        run.close()


def _add_point(run: Run, psnr: float | None):
    c = run.curves
    c.iteration.append(run.iteration)
    c.count.append(run.model.count)
    c.loss.append(run.loss)
    c.psnr.append(psnr)
