"""Charts of the comparison of methods, as SVG files made with matplotlib."""

from __future__ import annotations

from pathlib import Path

import matplotlib

matplotlib.use("svg")
matplotlib.rcParams |= {
    "svg.hashsalt": "svrgs",
    "svg.fonttype": "none",
    "font.size": 9,
    "axes.grid": True,
    "grid.color": "#e3e1dc",
}
import matplotlib.pyplot as plt  # noqa: E402  (after the choice of the backend)
from matplotlib.ticker import LogLocator, NullFormatter, StrMethodFormatter  # noqa: E402

MARKERS = "osD^v<>PX*hd"


def pareto_chart(curves: dict[str, list[tuple[int, float, float]]], title: str, path: Path):
    """PSNR and LPIPS over the number of Gaussians. curves: points (Gaussians, dB, LPIPS) of each method, by
    rising count."""
    figure, (left, right) = _psnr_and_lpips(curves, "Gaussians left")
    for axes in (left, right):
        axes.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axes.xaxis.set_major_formatter(StrMethodFormatter("{x:,.0f}"))
        axes.xaxis.set_minor_formatter(NullFormatter())
    figure.suptitle(title)
    _save(figure, path)


def _psnr_and_lpips(curves: dict[str, list[tuple[float, float, float]]], over: str):
    """A figure and its two axes: PSNR and LPIPS over the first value of each point. `removal` is black."""
    figure, both = plt.subplots(1, 2, figsize=(11, 4.5))
    for k, (method, points) in enumerate(sorted(curves.items())):
        style = {"color": "black", "linewidth": 2} if method == "removal" else {"color": plt.cm.tab20(k % 20)}
        first, *values = zip(*points, strict=True)
        for axes, those in zip(both, values, strict=True):
            axes.plot(first, those, MARKERS[k % len(MARKERS)] + "-", markersize=4, label=method, **style)
    for axes, name in zip(both, ("PSNR, dB", "LPIPS"), strict=True):
        axes.set_xscale("log")
        axes.set_xlabel(over)
        axes.set_ylabel(f"{name}, test views")
    both[1].legend(fontsize=8, loc="center left", bbox_to_anchor=(1, 0.5))
    return figure, both


def curve_chart(runs: list[tuple[str, dict]], title: str, path: Path):
    """Number of Gaussians and PSNR over iterations. runs: label and curves (lists iteration, count, psnr) of
    each run."""
    figure, (left, right) = plt.subplots(1, 2, figsize=(10, 4))
    for label, curves in runs:
        left.plot(curves["iteration"], curves["count"], label=label)
        right.plot(
            curves["iteration"],
            [value if value is not None else float("nan") for value in curves["psnr"]],
            label=label,
        )
    left.set_ylabel("Gaussians")
    left.set_ylim(bottom=0)
    right.set_ylabel("PSNR, dB")
    for axes in (left, right):
        axes.set_xlabel("iteration")
    left.legend(fontsize=8)
    figure.suptitle(title)
    _save(figure, path)


def looks_chart(points: dict[str, dict[str, tuple[float, float]]], path: Path):
    """PSNR in the end over the seconds of a look at what stays. points: by share that stays and by look."""
    figure, axes = plt.subplots(figsize=(8.5, 4.5))
    for marker, (share, looks) in zip(MARKERS, points.items(), strict=False):
        axes.plot(*zip(*looks.values(), strict=True), marker, label=f"{share} kept")
        for name, place in looks.items():
            axes.annotate(name, place, fontsize=7, rotation=25, xytext=(3, 4), textcoords="offset points")
    axes.set_xscale("log")
    axes.margins(x=0.2, y=0.4)
    axes.set_xlabel("seconds of one look")
    axes.set_ylabel("PSNR of the test views in the end, dB")
    axes.legend(fontsize=8)
    _save(figure, path)


def time_chart(curves: dict[str, list[tuple[float, float, float]]], before: float, title: str, path: Path):
    """PSNR and LPIPS over the seconds that jobs took. curves: points (seconds, dB, LPIPS) of each method, by
    rising time; before: dB of the scene that was pruned."""
    figure, (left, _) = _psnr_and_lpips(curves, "seconds of the whole job")
    left.axhline(before, color="black", linewidth=1, linestyle=":", label="before")
    left.legend(fontsize=8, handles=left.lines[-1:])
    figure.suptitle(title)
    _save(figure, path)


def _save(figure, path: Path):
    figure.tight_layout()
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
