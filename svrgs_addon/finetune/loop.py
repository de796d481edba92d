"""The loop of every run: steps, an observer after each, curves, checkpoints, and stops on request."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable
from dataclasses import dataclass

from ..system.errors import Cancelled, SplatError
from .run import Run

CURVE_VIEWS = 4  # test views on which the PSNR of the curves is measured
# points of the curves; least number of steps between two: a point takes as long as one or two steps
CURVE_POINTS, LEAST_BETWEEN = 40, 20
CHECKPOINT_SECONDS = 120.0  # between two checkpoints


@dataclass
class Progress:
    """The argument of an observer, made after each step."""

    iteration: int
    total: int
    phase: str
    label: str  # of the phase, as shown to users
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
    """Advances the run until it is finished, and saves checkpoints. Its curves get about CURVE_POINTS points,
    fewer in a short run.

    When stop() returns True, it saves a checkpoint and raises Cancelled. A SplatError, for example of a
    photograph that can no longer be read, is raised on after a checkpoint, if a step was done and none is
    half done.
    """
    total, begun, first, counted_from = run.plan.total, time.perf_counter(), run.iteration, run.iteration
    saved = time.monotonic()
    every = max(LEAST_BETWEEN, total // CURVE_POINTS)
    try:
        while not run.finished:
            phase, _ = run.phase()
            run.advance()
            if run.iteration % every == 0 or run.finished:
                run.curves.add(run.iteration, run.model.count, run.loss, measure())
            rate = (run.iteration - counted_from) / (time.perf_counter() - begun)
            # the first step also ranks Gaussians and fills caches: what follows is faster
            if run.iteration == first + 1:
                begun, counted_from = time.perf_counter(), run.iteration
            left = (total - run.iteration) / rate
            what = phase.name, phase.label, run.model.count, run.loss
            observe(Progress(run.iteration, total, *what, rate, left))
            if time.monotonic() - saved > CHECKPOINT_SECONDS:
                checkpoint()
                saved = time.monotonic()
            if stop() and not run.finished:
                checkpoint()
                raise Cancelled
    except SplatError:
        if run.between_steps and run.iteration > first:
            with contextlib.suppress(SplatError):
                checkpoint()
        raise
    finally:
        run.close()
