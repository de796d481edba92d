"""A line chart over iterations as inline SVG. Colours come from the page's CSS, so it follows light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import floor, log10

import numpy as np

WIDTH, HEIGHT = 420, 250
LEFT, RIGHT, TOP, BOTTOM = 48, 16, 26, 38  # margins that hold tick labels, phase names and the axis title
MAX_POINTS = 400  # about one per pixel


@dataclass(frozen=True)
class Series:
    """One curve: values over iterations; values that are not finite are left out."""

    title: str
    iterations: Sequence[int] | np.ndarray  # (n,) ascending
    values: Sequence[float | None] | np.ndarray  # (n,); None counts as not finite
    unit: str = ""
    from_zero: bool = False  # the axis starts at 0: for quantities whose ratio matters


def line_chart(series: Series, marks: tuple[tuple[int, str], ...] = ()) -> str:
    """An <svg> element, with a dashed line and a name at each mark (iteration, phase); '' without finite values."""
    x, y = _points(series)
    if len(x) == 0:
        return ""
    x_range = _padded(min([x[0], *(m for m, _ in marks)]), x[-1])
    y_range = _padded(0.0 if series.from_zero else y.min(), y.max())
    px = LEFT + (x - x_range[0]) / (x_range[1] - x_range[0]) * (WIDTH - LEFT - RIGHT)
    py = HEIGHT - BOTTOM - (y - y_range[0]) / (y_range[1] - y_range[0]) * (HEIGHT - TOP - BOTTOM)
    course = f"from {y[0]:.6g} to {y[-1]:.6g} {series.unit}".rstrip()
    summary = f"{series.title}: {course} over {x[-1] - x[0]:.0f} iterations"
    parts = [f'<svg viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(summary)}">']
    parts += _y_axis(y_range) + _x_axis(x_range) + _marks(marks, x_range)
    parts.append(f'<polyline class="curve" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in zip(px, py, strict=True))}"/>')
    if len(px) <= 40:
        parts += [f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="2.5"/>' for a, b in zip(px, py, strict=True)]
    return "".join(parts) + "</svg>"


def _points(series: Series) -> tuple[np.ndarray, np.ndarray]:
    """The finite points; beyond MAX_POINTS, neighbours are averaged."""
    x, y = np.asarray(series.iterations, np.float64), np.asarray(series.values, np.float64)
    x, y = x[np.isfinite(y)], y[np.isfinite(y)]
    if len(x) <= MAX_POINTS:
        return x, y
    starts = np.linspace(0, len(x), MAX_POINTS, endpoint=False).astype(int)
    counts = np.diff([*starts, len(x)])
    return np.add.reduceat(x, starts) / counts, np.add.reduceat(y, starts) / counts


def _padded(low: float, high: float) -> tuple[float, float]:
    """The range, never empty."""
    return (low, high) if high > low else (low - 0.5, high + 0.5)


def _ticks(low: float, high: float) -> np.ndarray:
    """Three to eight multiples of 1, 2 or 5 times a power of ten within the range."""
    rough = (high - low) / 5
    power = 10.0 ** floor(log10(rough))
    step = next(s for s in (power, 2 * power, 5 * power, 10 * power) if s >= rough * 0.999)
    return np.arange(int(np.ceil(low / step - 1e-9)), int(np.floor(high / step + 1e-9)) + 1) * step


def _number(value: float) -> str:
    for limit, unit, suffix in ((1e6, 1e6, "M"), (1e4, 1e3, "k")):
        if abs(value) >= limit:
            return f"{value / unit:.4g}{suffix}"
    return f"{value:.4g}"


def _y_axis(y_range: tuple[float, float]) -> list[str]:
    parts = []
    for tick in _ticks(*y_range):
        y = HEIGHT - BOTTOM - (tick - y_range[0]) / (y_range[1] - y_range[0]) * (HEIGHT - TOP - BOTTOM)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{y:.1f}" y2="{y:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{y + 4:.1f}" text-anchor="end">{_number(tick)}</text>')
    return parts


def _to_x(iteration: float, x_range: tuple[float, float]) -> float:
    return LEFT + (iteration - x_range[0]) / (x_range[1] - x_range[0]) * (WIDTH - LEFT - RIGHT)


def _x_axis(x_range: tuple[float, float]) -> list[str]:
    base = HEIGHT - BOTTOM
    parts = [f'<line class="axis" x1="{LEFT}" x2="{WIDTH - RIGHT}" y1="{base}" y2="{base}"/>']
    for tick in _ticks(*x_range):
        x = _to_x(tick, x_range)
        parts.append(f'<text class="tick" x="{x:.1f}" y="{base + 16}" text-anchor="middle">{_number(tick)}</text>')
    middle = (LEFT + WIDTH - RIGHT) / 2
    parts.append(f'<text class="tick" x="{middle:.0f}" y="{HEIGHT - 6}" text-anchor="middle">iteration</text>')
    return parts


def _marks(marks: tuple[tuple[int, str], ...], x_range: tuple[float, float]) -> list[str]:
    parts = []
    for iteration, name in marks:
        x = _to_x(iteration, x_range)
        parts.append(f'<line class="mark" x1="{x:.1f}" x2="{x:.1f}" y1="{TOP - 14}" y2="{HEIGHT - BOTTOM}"/>')
        anchor, shift = ("start", 4) if x < 0.8 * WIDTH else ("end", -4)
        parts.append(f'<text class="phase" x="{x + shift:.1f}" y="{TOP - 6}" text-anchor="{anchor}">{escape(name)}</text>')
    return parts
