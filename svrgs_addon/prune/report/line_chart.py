"""A line chart over iterations as inline SVG. Its colours come from the CSS of the page, so it follows light
and dark mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from .svg_axes import Frame, nice_ticks, short_number

# the margins hold tick texts, names of phases and the axis title
FRAME = Frame(width=420, height=250, left=48, right=16, top=26, bottom=38)
MAX_POINTS = 400  # about one per pixel


@dataclass(frozen=True)
class Series:
    """One curve: values over iterations. Values that are not finite are left out."""

    title: str
    iterations: Sequence[int] | np.ndarray  # (n,) ascending
    values: Sequence[float | None] | np.ndarray  # (n,); None counts as not finite
    unit: str = ""
    from_zero: bool = False  # the axis starts at 0, for quantities whose ratio matters


def line_chart(series: Series, marks: tuple[tuple[int, str], ...] = ()) -> str:
    """The chart as an <svg> element; '' if no value is finite. marks: (iteration, phase), each drawn as a
    dashed line with the name."""
    x, y = _points(series)
    if len(x) == 0:
        return ""
    x_range = _padded(min([x[0], *(m for m, _ in marks)]), x[-1])
    y_range = _padded(0.0 if series.from_zero else y.min(), y.max())
    px, py = FRAME.x(x, x_range), FRAME.y(y, y_range)
    course = f"from {y[0]:.6g} to {y[-1]:.6g} {series.unit}".rstrip()
    summary = f"{series.title}: {course} over {x[-1] - x[0]:.0f} iterations"
    parts = [f'<svg viewBox="0 0 {FRAME.width} {FRAME.height}" role="img" aria-label="{escape(summary)}">']
    parts += FRAME.y_axis(_ticks(y_range), y_range)
    parts += FRAME.x_axis(_ticks(x_range), x_range, "iteration")
    parts += _marks(marks, x_range)
    places = list(zip(px, py, strict=True))
    parts.append(f'<polyline class="curve" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in places)}"/>')
    if len(places) <= 40:
        parts += [f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="2.5"/>' for a, b in places]
    return "".join(parts) + "</svg>"


def _points(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """The finite points (iterations, values). If there are more than MAX_POINTS, neighbours are averaged."""
    x, y = np.asarray(series.iterations, np.float64), np.asarray(series.values, np.float64)
    x, y = x[np.isfinite(y)], y[np.isfinite(y)]
    if len(x) <= MAX_POINTS:
        return x, y
    starts = np.linspace(0, len(x), MAX_POINTS, endpoint=False).astype(int)
    counts = np.diff([*starts, len(x)])
    return np.add.reduceat(x, starts) / counts, np.add.reduceat(y, starts) / counts


def _padded(low: float, high: float) -> tuple[float, float]:
    """The range low..high, widened by 0.5 at both ends if it is empty."""
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _ticks(ends: tuple[float, float]) -> list[tuple[float, str]]:
    return [(value, short_number(value)) for value in nice_ticks(*ends)]


def _marks(marks: tuple[tuple[int, str], ...], x_range: tuple[float, float]) -> list[str]:
    parts = []
    for iteration, name in marks:
        x = FRAME.x(iteration, x_range)
        parts.append(
            f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{FRAME.top - 14}" y2="{FRAME.base}"/>'
        )
        anchor, shift = ("start", 4) if x < 0.8 * FRAME.width else ("end", -4)
        parts.append(
            f'<text class="phase" x="{x + shift:.1f}" y="{FRAME.top - 6}"'
            f' text-anchor="{anchor}">{escape(name)}</text>'
        )
    return parts
