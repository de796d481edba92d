"""Labelled points on linear or logarithmic axes, as an SVG document for light and dark mode."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

from .svg_axes import Frame, nice_ticks, short_number

# the margins hold tick texts and titles
FRAME = Frame(width=640, height=400, left=66, right=28, top=48, bottom=54)
LINE = 15  # pixels between labels that would overlap
STYLE = """
svg { background: #fff; font: 13px system-ui, "Segoe UI", Roboto, Arial, sans-serif; }
.title { fill: #1d1f23; font-size: 15px; font-weight: 600; }
.label { fill: #1d1f23; stroke: #fff; stroke-width: 4px; paint-order: stroke; }
.tick { fill: #62666e; } .grid { stroke: #e3e1dc; } .axis { stroke: #62666e; } .leader { stroke: #a5a8ae; }
.front { fill: none; stroke: #b5441f; stroke-width: 1.5; stroke-dasharray: 5 4; }
.dot { fill: #b5441f; } .ring { fill: none; stroke: #b5441f; stroke-width: 2; }
@media (prefers-color-scheme: dark) { svg { background: #1f2125; }
.title, .label { fill: #e8e6e1; } .label { stroke: #1f2125; } .tick { fill: #9fa3ab; }
.grid { stroke: #34373d; } .axis { stroke: #9fa3ab; } .leader { stroke: #6a6e76; }
.front, .ring { stroke: #f19a6b; } .dot { fill: #f19a6b; } }
"""


@dataclass(frozen=True)
class Point:
    """One point of a chart, in the values of the axes, and its label."""

    x: float
    y: float
    label: str
    marked: bool = False  # drawn with a ring


@dataclass(frozen=True)
class Axis:
    """One axis. A position is the value, or its base-10 logarithm on a logarithmic axis."""

    title: str
    log: bool = False  # values below TINY count as TINY
    from_zero: bool = False

    TINY = 1e-12

    def position(self, value: float) -> float:
        return log10(max(value, self.TINY)) if self.log else value

    def range(self, values: Sequence[float]) -> tuple[float, float]:
        """Positions of the ends of the axis: those of the values, and a margin."""
        positions = [self.position(value) for value in values]
        low, high = (0.0 if self.from_zero else min(positions)), max(positions)
        margin = max(0.12 * (high - low), 0.35 if self.log else 0.05 * abs(high) or 0.5)
        return low - margin * (not self.from_zero), high + margin

    def ticks(self, low: float, high: float) -> list[tuple[float, str]]:
        """(position, text) at round values."""
        if not self.log:
            return [(value, short_number(value)) for value in nice_ticks(low, high)]
        steps = (1,) if high - low > 2.5 else (1, 2, 5)
        values = [(power, step) for power in range(floor(low), ceil(high) + 1) for step in steps]
        return [
            (power + log10(step), short_number(step * 10.0**power))
            for power, step in values
            if low <= power + log10(step) <= high
        ]


def front(points: list[Point]) -> list[Point]:
    """The Pareto front: the points that no other point beats in both values, of which less is better, by
    rising x."""
    best = float("inf")
    found: list[Point] = []
    for point in sorted(points, key=lambda p: (p.x, p.y)):
        if point.y < best:
            best, found = point.y, [*found, point]
    return found


def chart(
    title: str, points: list[Point], x: Axis, y: Axis, line: Sequence[Point] = (), rings: Sequence[Point] = ()
) -> str:
    """The chart as an SVG document: points with their labels, a dashed line through the points of `line`, and
    a second series as rings."""
    x_range, y_range = x.range([p.x for p in points]), y.range([p.y for p in (*points, *rings)])

    def place(p: Point) -> tuple[float, float]:
        return FRAME.x(x.position(p.x), x_range), FRAME.y(y.position(p.y), y_range)

    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {FRAME.width} {FRAME.height}" role="img"'
        f' aria-label="{escape(title)}">'
    ]
    parts += [
        f"<style>{STYLE}</style>",
        f'<text class="title" x="{FRAME.left}" y="26">{escape(title)}</text>',
    ]
    parts += _axes(x, x_range, y, y_range)
    parts.append(
        f'<polyline class="front" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in map(place, line))}"/>'
    )
    for point, (a, b) in ((p, place(p)) for p in points):
        parts.append(f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="4"/>')
        if point.marked:
            parts.append(f'<circle class="ring" cx="{a:.1f}" cy="{b:.1f}" r="8"/>')
    parts += [f'<circle class="ring" cx="{a:.1f}" cy="{b:.1f}" r="4"/>' for a, b in map(place, rings)]
    return "\n".join((*parts, *_labels([(p, *place(p)) for p in points]), "</svg>\n"))


def _axes(x: Axis, x_range: tuple[float, float], y: Axis, y_range: tuple[float, float]) -> list[str]:
    middle = (FRAME.top + FRAME.base) / 2
    title = (
        f'<text class="tick" transform="translate(16 {middle:.0f}) rotate(-90)"'
        f' text-anchor="middle">{escape(y.title)}</text>'
    )
    return [
        *FRAME.y_axis(y.ticks(*y_range), y_range),
        *FRAME.x_axis(x.ticks(*x_range), x_range, escape(x.title), grid=True),
        title,
    ]


def _labels(placed: list[tuple[Point, float, float]]) -> list[str]:
    """The labels of points. A label is at the right of its point, or at the left if the point is far right;
    it moves down if it would overlap another."""
    parts: list[str] = []
    taken: list[tuple[float, float, float]] = []  # top, left and right of the labels so far
    for point, a, b in sorted(placed, key=lambda item: item[2]):
        side = -1 if a > 0.75 * FRAME.width else 1
        text = point.label + (" (default)" if point.marked else "")
        left = a + 13 if side > 0 else a - 13 - 7.5 * len(text)
        right, top = left + 7.5 * len(text), b
        while any(abs(top - other) < LINE and left < end and start < right for other, start, end in taken):
            top += 1
        taken.append((top, left, right))
        if top > b + LINE / 2:
            parts.append(
                f'<line class="leader" x1="{a + 5 * side:.1f}" y1="{b:.1f}" x2="{a + 11 * side:.1f}"'
                f' y2="{top:.1f}"/>'
            )
        anchor = "start" if side > 0 else "end"
        parts.append(
            f'<text class="label" x="{a + 13 * side:.1f}" y="{top + 4:.1f}"'
            f' text-anchor="{anchor}">{escape(text)}</text>'
        )
    return parts
