"""Which charts a result gives: one per knob, two for scaling."""

from __future__ import annotations

from .chart import Axis, Point, chart

# knob -> what the chart is called
KNOBS = {
    "simd": "SIMD level",
    "exp_degree": "Degree of the polynomial for 2^x",
    "alpha_cut": "Alpha below which a Gaussian does not hit a pixel",
    "stop": "Transmittance at which a pixel stops",
    "tile": "Tile side, pixels",
    "block": "Pixels of a block",
}
SCALING = {"pixels": "pixels", "gaussians": "count"}  # axis -> what grows along it
LARGE_RATIO = 10  # times further apart than this are drawn on a logarithmic axis


def drawings(result: dict) -> dict[str, str]:
    """{file name without its suffix: SVG document} of everything in the result that can be drawn."""
    found = {}
    for knob, title in KNOBS.items():
        if entries := [entry for entry in result.get("knobs", ()) if entry["knob"] == knob]:
            found[f"knob-{knob}"] = knob_chart(title, entries)
    for axis, key in SCALING.items():
        if entries := [entry for entry in result.get("scaling", ()) if entry["axis"] == axis]:
            found[f"scaling-{axis}"] = scaling_chart(axis, entries, key)
    return found


def knob_chart(title: str, knobs: list[dict]) -> str:
    """Forward time over mean image error; entries of the result's `knobs`."""
    points = [Point(k["image_mean"], k["forward_ms"], k["value"], k["default"]) for k in knobs]
    times = [point.y for point in points]
    y = Axis("forward, ms", log=True) if max(times) > LARGE_RATIO * min(times) else Axis("forward, ms", from_zero=True)
    return chart(title, points, Axis("mean image error against float64, 0..1", log=True), y, front(points))


def scaling_chart(axis: str, scaling: list[dict], key: str) -> str:
    """Forward time over pixels or Gaussians, both logarithmic; entries of the result's `scaling`."""
    points = [Point(s[key], s["forward_ms"], f"{s['forward_ms']:.3g} ms") for s in scaling]
    return chart(f"Forward time over {axis}", points, Axis(axis, log=True), Axis("forward, ms", log=True), points)


def front(points: list[Point]) -> list[Point]:
    """The points that none beats in both time and error, by rising error."""
    best = float("inf")
    found: list[Point] = []
    for point in sorted(points, key=lambda p: (p.x, p.y)):
        if point.y < best:
            best, found = point.y, [*found, point]
    return found
