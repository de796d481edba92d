"""Axes of SVG charts: round tick values, short number texts, grid lines. The charts of the report and of
`svrgs bench` use it."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass
from math import ceil, floor, log10

Ticks = Iterable[tuple[float, str]]  # position on the axis, text


@dataclass(frozen=True)
class Frame:
    """The plotting area of a chart: size of the picture and the margins around the area, in pixels.

    `ends` in the methods are the positions on the axis at the left and right, or lower and upper, side of the
    area.
    """

    width: int
    height: int
    left: int
    right: int
    top: int
    bottom: int

    @property
    def base(self) -> int:
        """y of the x axis, in pixels."""
        return self.height - self.bottom

    @property
    def end(self) -> int:
        """x of the right side of the area, in pixels."""
        return self.width - self.right

    def x(self, position, ends: tuple[float, float]):
        """x in pixels of a position, or of an array of positions."""
        return self.left + (position - ends[0]) / (ends[1] - ends[0]) * (self.end - self.left)

    def y(self, position, ends: tuple[float, float]):
        """y in pixels of a position, or of an array of positions; y points down."""
        return self.base - (position - ends[0]) / (ends[1] - ends[0]) * (self.base - self.top)

    def y_axis(self, ticks: Ticks, ends: tuple[float, float]) -> list[str]:
        """A horizontal grid line and a text at the left of it for each tick."""
        parts = []
        for position, text in ticks:
            y = self.y(position, ends)
            parts.append(f'<line class="grid" x1="{self.left}" x2="{self.end}" y1="{y:.1f}" y2="{y:.1f}"/>')
            parts.append(
                f'<text class="tick" x="{self.left - 8}" y="{y + 4:.1f}" text-anchor="end">{text}</text>'
            )
        return parts

    def x_axis(self, ticks: Ticks, ends: tuple[float, float], title: str, grid: bool = False) -> list[str]:
        """The axis line, a text below it for each tick, and the title (escaped). grid: also a vertical grid
        line for each tick."""
        parts, texts = [], []
        for position, text in ticks:
            x = self.x(position, ends)
            if grid:
                parts.append(
                    f'<line class="grid" x1="{x:.1f}" x2="{x:.1f}" y1="{self.top}" y2="{self.base}"/>'
                )
            texts.append(
                f'<text class="tick" x="{x:.1f}" y="{self.base + 17}" text-anchor="middle">{text}</text>'
            )
        parts.append(
            f'<line class="axis" x1="{self.left}" x2="{self.end}" y1="{self.base}" y2="{self.base}"/>'
        )
        middle = (self.left + self.end) / 2
        return [
            *parts,
            *texts,
            f'<text class="tick" x="{middle:.0f}" y="{self.height - 8}" text-anchor="middle">{title}</text>',
        ]


def nice_ticks(low: float, high: float) -> list[float]:
    """Three to eight multiples of 1, 2 or 5 times a power of ten within low..high, where low < high."""
    rough = (high - low) / 5
    power = 10.0 ** floor(log10(rough))
    step = next(s for s in (power, 2 * power, 5 * power, 10 * power) if s >= rough * 0.999)
    return [n * step for n in range(ceil(low / step - 1e-9), floor(high / step + 1e-9) + 1)]


def short_number(value: float) -> str:
    """A number of at most four digits: 0.05, 9999, 10 k, 2.5 M, 1e10, 2e-7."""
    size = abs(value)
    if size >= 1e10 or 0 < size < 1e-3:
        digits, _, exponent = f"{value:.3e}".partition("e")
        return f"{float(digits):.4g}e{int(exponent)}"
    for limit, unit, suffix in ((1e6, 1e6, " M"), (1e4, 1e3, " k")):
        if size >= limit:
            return f"{value / unit:.4g}{suffix}"
    return f"{value:.4g}"
