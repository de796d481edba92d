"""The charts of a result: one per knob, and two for scaling."""

from __future__ import annotations

from svrgs_addon.prune.report.point_chart import Axis, Point, chart, front

# knob -> title of the chart
KNOBS = {
    "simd": "SIMD level",
    "exp_degree": "Degree of the polynomial for 2^x",
    "alpha_cut": "Alpha below which a Gaussian does not hit a pixel",
    "stop": "Transmittance at which a pixel stops",
    "tile": "Tile side, pixels",
    "block": "Pixels of a block",
}
# axis -> key of the entries of `scaling` with its values
SCALING = {"pixels": "pixels", "gaussians": "count"}
LARGE_RATIO = 10  # if the longest time is more than so many times the shortest, the axis is logarithmic


def charts(result: dict) -> dict[str, str]:
    """All charts of the result: {file name without suffix: SVG document}."""
    found = {}
    for knob, title in KNOBS.items():
        if entries := [entry for entry in result.get("knobs", ()) if entry["knob"] == knob]:
            found[f"knob-{knob}"] = knob_chart(title, entries)
    for axis, key in SCALING.items():
        if entries := [entry for entry in result.get("scaling", ()) if entry["axis"] == axis]:
            found[f"scaling-{axis}"] = scaling_chart(axis, entries, key)
    return found


def knob_chart(title: str, knobs: list[dict]) -> str:
    """Forward time over mean image error. knobs: the entries of one knob."""
    points = [Point(k["image_mean"], k["forward_ms"], k["value"], k["default"]) for k in knobs]
    times = [point.y for point in points]
    logarithmic = max(times) > LARGE_RATIO * min(times)
    y = Axis("forward, ms", log=logarithmic, from_zero=not logarithmic)
    return chart(title, points, Axis("mean image error against float64, 0..1", log=True), y, front(points))


def scaling_chart(axis: str, scaling: list[dict], key: str) -> str:
    """Forward time over pixels or Gaussians, on logarithmic axes. scaling: the entries of one axis; key: the
    values of the x axis."""
    points = [Point(s[key], s["forward_ms"], f"{s['forward_ms']:.3g} ms") for s in scaling]
    x, y = Axis(axis, log=True), Axis("forward, ms", log=True)
    return chart(f"Forward time over {axis}", points, x, y, points)
