"""Labelled points on linear or logarithmic axes as an SVG file of its own, readable on light and dark."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from math import ceil, floor, log10

WIDTH, HEIGHT = 640, 400
LEFT, RIGHT, TOP, BOTTOM = 66, 28, 48, 54  # margins that hold tick labels and titles
LINE = 15  # between labels that would lie over each other
STYLE = """
svg { background: #fff; font: 13px system-ui, "Segoe UI", Roboto, Arial, sans-serif; }
.title { fill: #1d1f23; font-size: 15px; font-weight: 600; }
.label { fill: #1d1f23; stroke: #fff; stroke-width: 4px; paint-order: stroke; }
.tick { fill: #62666e; } .grid { stroke: #e3e1dc; } .axis { stroke: #62666e; } .leader { stroke: #a5a8ae; }
.front { fill: none; stroke: #b5441f; stroke-width: 1.5; stroke-dasharray: 5 4; }
.dot { fill: #b5441f; } .ring { fill: none; stroke: #b5441f; stroke-width: 2; }
@media (prefers-color-scheme: dark) { svg { background: #1f2125; } .title, .label { fill: #e8e6e1; } .label { stroke: #1f2125; } .tick { fill: #9fa3ab; }
.grid { stroke: #34373d; } .axis { stroke: #9fa3ab; } .leader { stroke: #6a6e76; } .front, .ring { stroke: #f19a6b; } .dot { fill: #f19a6b; } }
"""


@dataclass(frozen=True)
class Point:
    x: float
    y: float
    label: str
    marked: bool = False  # a ring around it


@dataclass(frozen=True)
class Axis:
    """How values become positions."""

    title: str
    log: bool = False  # values must be positive; smaller ones count as TINY
    from_zero: bool = False

    TINY = 1e-12

    def position(self, value: float) -> float:
        return log10(max(value, self.TINY)) if self.log else value

    def range(self, values: Sequence[float]) -> tuple[float, float]:
        """Positions of the ends: the values and some air around them."""
        positions = [self.position(value) for value in values]
        low, high = (0.0 if self.from_zero else min(positions)), max(positions)
        air = max(0.12 * (high - low), 0.35 if self.log else 0.05 * abs(high) or 0.5)
        return low - air * (not self.from_zero), high + air

    def ticks(self, low: float, high: float) -> list[tuple[float, str]]:
        """(position, text) at round values."""
        if not self.log:
            return [(value, f"{value:.6g}") for value in _multiples(low, high)]
        steps = (1,) if high - low > 2.5 else (1, 2, 5)
        values = [(power, step) for power in range(floor(low), ceil(high) + 1) for step in steps]
        return [(power + log10(step), _short(step, power)) for power, step in values if low <= power + log10(step) <= high]


def chart(title: str, points: list[Point], x: Axis, y: Axis, line: Sequence[Point] = (), rings: Sequence[Point] = ()) -> str:
    """An SVG document: the points with their labels, a dashed line through those of `line`, and a second series as rings."""
    x_range, y_range = x.range([p.x for p in points]), y.range([p.y for p in (*points, *rings)])

    def place(p: Point) -> tuple[float, float]:
        return _across(x.position(p.x), x_range), _down(y.position(p.y), y_range)

    parts = [f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {HEIGHT}" role="img" aria-label="{escape(title)}">']
    parts += [f"<style>{STYLE}</style>", f'<text class="title" x="{LEFT}" y="26">{escape(title)}</text>']
    parts += _axes(x, x_range, y, y_range)
    parts.append(f'<polyline class="front" points="{" ".join(f"{a:.1f},{b:.1f}" for a, b in map(place, line))}"/>')
    for point, (a, b) in ((p, place(p)) for p in points):
        parts.append(f'<circle class="dot" cx="{a:.1f}" cy="{b:.1f}" r="4"/>')
        if point.marked:
            parts.append(f'<circle class="ring" cx="{a:.1f}" cy="{b:.1f}" r="8"/>')
    parts += [f'<circle class="ring" cx="{a:.1f}" cy="{b:.1f}" r="4"/>' for a, b in map(place, rings)]
    return "\n".join((*parts, *_labels([(p, *place(p)) for p in points]), "</svg>\n"))


def _axes(x: Axis, x_range: tuple[float, float], y: Axis, y_range: tuple[float, float]) -> list[str]:
    base, end = HEIGHT - BOTTOM, WIDTH - RIGHT
    parts = []
    for position, text in y.ticks(*y_range):
        b = _down(position, y_range)
        parts.append(f'<line class="grid" x1="{LEFT}" x2="{end}" y1="{b:.1f}" y2="{b:.1f}"/>')
        parts.append(f'<text class="tick" x="{LEFT - 8}" y="{b + 4:.1f}" text-anchor="end">{text}</text>')
    for position, text in x.ticks(*x_range):
        a = _across(position, x_range)
        parts.append(f'<line class="grid" x1="{a:.1f}" x2="{a:.1f}" y1="{TOP}" y2="{base}"/>')
        parts.append(f'<text class="tick" x="{a:.1f}" y="{base + 18}" text-anchor="middle">{text}</text>')
    parts.append(f'<line class="axis" x1="{LEFT}" x2="{end}" y1="{base}" y2="{base}"/>')
    parts.append(f'<text class="tick" x="{(LEFT + end) / 2:.0f}" y="{HEIGHT - 12}" text-anchor="middle">{escape(x.title)}</text>')
    parts.append(f'<text class="tick" transform="translate(16 {(TOP + base) / 2:.0f}) rotate(-90)" text-anchor="middle">{escape(y.title)}</text>')
    return parts


def _labels(placed: list[tuple[Point, float, float]]) -> list[str]:
    """Names beside their points, to the left of those far right, moved down where they would lie over another's."""
    parts: list[str] = []
    taken: list[tuple[float, float, float]] = []  # top, left and right of the labels so far
    for point, a, b in sorted(placed, key=lambda item: item[2]):
        side = -1 if a > 0.75 * WIDTH else 1
        text = point.label + (" (default)" if point.marked else "")
        left = a + 13 if side > 0 else a - 13 - 7.5 * len(text)
        right, top = left + 7.5 * len(text), b
        while any(abs(top - other) < LINE and left < end and start < right for other, start, end in taken):
            top += 1
        taken.append((top, left, right))
        if top > b + LINE / 2:
            parts.append(f'<line class="leader" x1="{a + 5 * side:.1f}" y1="{b:.1f}" x2="{a + 11 * side:.1f}" y2="{top:.1f}"/>')
        anchor = "start" if side > 0 else "end"
        parts.append(f'<text class="label" x="{a + 13 * side:.1f}" y="{top + 4:.1f}" text-anchor="{anchor}">{escape(text)}</text>')
    return parts


def _across(position: float, ends: tuple[float, float]) -> float:
    return LEFT + (position - ends[0]) / (ends[1] - ends[0]) * (WIDTH - LEFT - RIGHT)


def _down(position: float, ends: tuple[float, float]) -> float:
    return HEIGHT - BOTTOM - (position - ends[0]) / (ends[1] - ends[0]) * (HEIGHT - TOP - BOTTOM)


def _multiples(low: float, high: float) -> list[float]:
    """Three to eight multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / 5
    power = 10.0 ** floor(log10(rough))
    step = next(s for s in (power, 2 * power, 5 * power, 10 * power) if s >= rough * 0.999)
    return [n * step for n in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


def _short(step: int, power: int) -> str:
    """step * 10^power: 0.05, 200, 5 M, 2e-7."""
    value = step * 10.0**power
    for unit, suffix in ((6, " M"), (3, " k")):
        if unit <= power <= 9:
            return f"{step * 10 ** (power - unit)}{suffix}"
    return f"{value:g}" if -3 <= power < 3 else f"{step}e{power}"
