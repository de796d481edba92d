"""The HTML page of a report: a table of quality and size, curves, and pictures of a few views.

The page is one file: pictures are data URIs, curves are inline SVG, and its content security policy forbids
to load anything. `svrgs prune --report` and `svrgs compare` fill the same Report; each leaves out what it
does not have.
"""

from __future__ import annotations

import math
import shlex
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from html import escape
from pathlib import Path

import numpy as np

from ... import __version__
from ...files.atomic import atomic_write
from ...files.images import to_bytes
from ...files.reading import readable
from ...render.color_maps import hex_colors
from ...system.errors import SceneError
from ...system.memory import size_text
from .line_chart import Series, line_chart
from .pictures import DIFFERENCE_GAIN, data_uri, difference_image, mask_to_rgb
from .style import CSS, SCRIPT

# of a report; by it, one is told from a page of another program
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; script-src 'unsafe-inline'"
HEAD_BYTES = 1 << 10  # of a page, in which it stands
# of F, gets the brightest colour: with the maximum, one bright pixel would darken all masks
MASK_PERCENTILE = 99.5

# keys psnr ssim lpips flip count bytes ms_per_frame; None or missing: not measured
Quality = dict[str, float | int | None]


@dataclass(frozen=True)
class Phase:
    """A part of the run, for the table of seconds and the marks in the curves."""

    name: str
    seconds: float
    start: int | None = None  # first iteration; None: not part of the optimisation


@dataclass(frozen=True)
class View:
    """One test view. Images are (H, W, 3) floats in 0..1; spatial masks F are (H, W) floats ≥ 0; PSNR is in
    dB."""

    name: str
    before: np.ndarray
    after: np.ndarray
    photo: np.ndarray | None = None
    mask_before: np.ndarray | None = None
    mask_after: np.ndarray | None = None
    psnr_before: float | None = None  # None: the photograph is a picture of the scene before
    psnr_after: float | None = None


@dataclass(frozen=True)
class Report:
    """The contents of a page. before, after: figures with the keys of `svrgs eval --json`."""

    scene: str
    before: Quality
    after: Quality
    names: tuple[str, str] = ("original", "pruned")  # names of before and after on the page
    method: str | None = None
    lambda_f: float | None = None
    lpips_missing: str = ""  # why lpips is None
    notes: Sequence[str] = ()  # sentences that the user must see, such as which photographs are missing
    phases: tuple[Phase, ...] = ()
    seconds: float | None = None  # total
    iterations_per_second: float | None = None
    peak_memory_bytes: int | None = None
    seed: int | None = None
    versions: dict[str, str] = field(default_factory=dict)
    curves: tuple[Series, ...] = ()
    views: tuple[View, ...] = ()
    swing: np.ndarray | None = None  # (frames, H, W, 3) uint8 (swing.py): before and after side by side
    files: tuple[str, ...] = ()  # those of before and after, to be looked at with svrgs view


def refuse_other_page(folder: Path, mark: str = POLICY):
    """Raises SceneError if the folder holds a page without this mark in its head, FormatError if it cannot be
    read."""
    page = folder / "index.html"
    if not page.exists():
        return
    with readable(page), open(page, "rb") as file:
        head = file.read(HEAD_BYTES)
    if mark.encode() not in head:
        raise SceneError(f"{folder} holds another page: name a new folder")


def write_report(folder: str | Path, report: Report) -> Path:
    """Writes folder/index.html and returns its path. The folder is made if needed; the file is replaced as a
    whole. Raises SceneError if it cannot be written."""
    path = Path(folder) / "index.html"
    with atomic_write(path) as file:
        # paths need not be UTF-8
        file.write(page(report).encode(errors="surrogateescape").decode(errors="replace").encode())
    return path


def page(report: Report) -> str:
    """The HTML page as text."""
    figures = f'<div class="columns">\n{_quality(report)}\n{_run(report)}\n</div>'
    sections = (_head(report), figures, _swing(report), _curves(report), _views(report))
    return (
        '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">\n'
        '<meta name="viewport" content="width=device-width, initial-scale=1">\n'
        f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">\n'
        f"<title>{escape(report.scene)}: {escape(' and '.join(report.names))}</title>\n"
        f"<style>{CSS}</style>\n</head>\n<body>\n"
        + "\n".join(section for section in sections if section)
        + f"\n<footer>SVR-GS {__version__}</footer>\n<script>{SCRIPT}</script>\n</body>\n</html>\n"
    )


# --- numbers as text ---


def _integer(value: float) -> str:
    return f"{value:,.0f}".replace(",", "\N{NARROW NO-BREAK SPACE}")


def _duration(seconds: float) -> str:
    if seconds < 100:
        return f"{seconds:.1f} s"
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes} min" if hours else f"{minutes} min {rest} s"


def _signed(text: str) -> str:
    return text.replace("-", "\N{MINUS SIGN}")


def _decimals(digits: int, unit: str = "") -> Callable[[float], str]:
    return lambda value: "∞" if math.isinf(value) else _signed(f"{value:.{digits}f}{unit}")


@dataclass(frozen=True)
class _Row:
    """One line of the table of quality and size."""

    key: str
    label: str
    text: Callable[[float], str]
    better: int  # +1 if higher is better, -1 if lower is better
    change: Callable[[float], str] | None = None  # from after - before to text; None: shown in per cent


ROWS = (
    _Row("psnr", "PSNR", _decimals(2, " dB"), +1, lambda d: f"{d:+.2f} dB"),
    _Row("ssim", "SSIM", _decimals(4), +1, lambda d: f"{d:+.4f}"),
    _Row("lpips", "LPIPS (VGG)", _decimals(4), -1, lambda d: f"{d:+.4f}"),
    _Row("flip", "FLIP", _decimals(4), -1, lambda d: f"{d:+.4f}"),
    _Row("count", "Gaussians", _integer, -1),
    _Row("bytes", "File size", size_text, -1),
    _Row("ms_per_frame", "Time per frame", _decimals(1, " ms"), -1),
)


# --- the parts of the page ---


def _head(report: Report) -> str:
    settings = [f"method {escape(report.method)}"] if report.method else []
    settings += [f"λ<sub>F</sub> = {report.lambda_f:g}"] if report.lambda_f is not None else []
    before, after = report.before.get("count"), report.after.get("count")
    if before and after is not None:
        settings.append(f"{_integer(before)} → {_integer(after)} Gaussians ({_per_cent(before, after)})")
    notes = "".join(f'\n<p class="note">{escape(note)}</p>' for note in report.notes)
    return (
        f"<header>\n<h1>{escape(report.scene)}</h1>\n<p"
        f' class="soft">{" · ".join(settings)}</p>{notes}\n</header>'
    )


def _quality(report: Report) -> str:
    rows = "\n".join(_quality_row(row, report) for row in ROWS)
    before, after = (escape(name) for name in report.names)
    return (
        '<section><h2>Quality and size</h2>\n<div class="card scroll"><table>\n'
        f'<thead><tr><th scope="col">Measure</th><th scope="col">{before}</th><th scope="col">{after}</th>'
        f'<th scope="col">Change</th></tr></thead>\n<tbody>\n{rows}\n</tbody></table></div>\n'
        '<p class="soft">PSNR and SSIM: higher is better. All others: lower is better.</p></section>'
    )


def _quality_row(row: _Row, report: Report) -> str:
    before, after = report.before.get(row.key), report.after.get(row.key)
    label = f'<tr><th scope="row">{row.label}</th>'
    if before is None and after is None:
        why = report.lpips_missing if row.key == "lpips" and report.lpips_missing else "not measured"
        return f'{label}<td class="soft" colspan="3">{escape(why)}</td></tr>'
    values = "".join(f"<td>{'–' if value is None else row.text(value)}</td>" for value in (before, after))
    return f"{label}{values}{_change_cell(row, before, after)}</tr>"


def _change_cell(row: _Row, before: float | None, after: float | None) -> str:
    if (
        before is None
        or after is None
        or not math.isfinite(after - before)
        or (row.change is None and before == 0)
    ):
        return "<td>–</td>"
    change = after - before
    verdict = "" if change == 0 else "good" if change * row.better > 0 else "bad"
    text = _signed(row.change(change)) if row.change else _per_cent(before, after)
    return f'<td class="{verdict}">{text}</td>'


def _per_cent(before: float, after: float) -> str:
    return _signed(f"{(after - before) / before * 100:+.1f} %")


def _run(report: Report) -> str:
    """The section on the run: seconds per phase, speed, memory, seed, versions. '' if none is known."""
    facts = list(_facts(report))
    if not facts:
        return ""
    items = "".join(f"<dt>{escape(name)}</dt><dd>{escape(text)}</dd>\n" for name, text in facts)
    return f'<section><h2>The run</h2>\n<div class="card"><dl>\n{items}</dl></div></section>'


def _facts(report: Report) -> Iterator[tuple[str, str]]:
    for phase in report.phases:
        yield phase.name.capitalize(), _duration(phase.seconds)
    if report.seconds is not None:
        yield "Total", _duration(report.seconds)
    if report.iterations_per_second is not None:
        yield "Speed", f"{report.iterations_per_second:.3g} iterations/s"
    if report.peak_memory_bytes is not None:
        yield "Peak memory", size_text(report.peak_memory_bytes)
    if report.seed is not None:
        yield "Seed", str(report.seed)
    if report.versions:
        yield "Versions", ", ".join(f"{name} {version}" for name, version in report.versions.items())


def _curves(report: Report) -> str:
    marks = tuple((phase.start, phase.name) for phase in report.phases if phase.start is not None)
    charts = [(series, line_chart(series, marks)) for series in report.curves]
    figures = "\n".join(
        "<figure"
        f' class="card"><h3>{escape(series.title + (series.unit and f" ({series.unit})"))}</h3>{svg}</figure>'
        for series, svg in charts
        if svg
    )
    return f'<h2>Over the iterations</h2>\n<div class="columns">\n{figures}\n</div>' if figures else ""


# --- views ---


def _swing(report: Report) -> str:
    """The swing as one picture of all its frames, which a style moves; and how to turn the scenes by hand."""
    if report.swing is None:
        return ""
    frames, height, width, _ = report.swing.shape
    strip = np.concatenate([*report.swing], axis=1)
    before, after = (escape(name) for name in report.names)
    style = f"aspect-ratio:{width}/{height};background:url({data_uri(strip)}) 0 0/{100 * frames}% 100%"
    steps = f"animation-timing-function:steps({frames}, jump-none)"
    command = escape(shlex.join(["svrgs", "view", *report.files]))
    turn = f'\n<p class="soft">To turn them: <code>{command}</code></p>' if report.files else ""
    seen = f'role="img" aria-label="{before} and {after}, seen from changing sides"'
    return (
        f'<h2>In space</h2>\n<figure class="card"><div class="swing" {seen} style="{style};{steps}"></div>'
        f"<figcaption>{before}, {after}</figcaption>{turn}</figure>"
    )


def _views(report: Report) -> str:
    if not report.views:
        return ""
    top = _mask_range(report.views)
    views = "\n".join(_view(view, report.names, top) for view in report.views)
    before, after = (escape(name) for name in report.names)
    explained = (
        f'<p class="soft">Move the pointer across “{after}” to show “{before}” behind it. Differences are'
        f" multiplied by {DIFFERENCE_GAIN}."
    )
    if top is not None:
        explained += " The spatial mask F is bright where the ray of a pixel hits many Gaussians."
    return f"<h2>Views</h2>\n{explained}</p>\n{views}"


def _mask_range(views: tuple[View, ...]) -> float | None:
    """The value of F with the brightest colour. All masks on the page share it, so that their colours can be
    compared. None without masks."""
    masks = (mask for view in views for mask in (view.mask_before, view.mask_after))
    known = [mask.ravel() for mask in masks if mask is not None]
    return float(np.percentile(np.concatenate(known), MASK_PERCENTILE)) if known else None


def _view(view: View, names: tuple[str, str], mask_top: float | None) -> str:
    before, after = names
    figures = [_figure("photograph", view.name, to_bytes(view.photo))] if view.photo is not None else []
    figures.append(_figure(before, view.name, to_bytes(view.before), css="original"))
    figures.append(_figure(after, view.name, to_bytes(view.after), stack=True))
    difference = difference_image(view.before, view.after)
    figures.append(_figure(f"difference {before} – {after}, × {DIFFERENCE_GAIN}", view.name, difference))
    for name, mask in zip(names, (view.mask_before, view.mask_after), strict=True):
        if mask is not None and mask_top is not None:
            title = f"spatial mask F, {name}: mean {float(mask.mean()):.3g}"
            colours, bar = mask_to_rgb(mask, mask_top), _colour_bar(mask_top)
            figures.append(_figure(title, view.name, colours, below=bar))
    pictures, across = "\n".join(figures), 4 if len(figures) == 4 else 3
    return (
        f'<section class="view card"><header><h3>{escape(view.name)}</h3>{_view_psnr(view)}</header>\n'
        f'<div class="pictures" style="--across:{across}">\n{pictures}\n</div></section>'
    )


def _view_psnr(view: View) -> str:
    if view.psnr_after is None:
        return ""
    decibels = _decimals(2)
    if view.psnr_before is None:
        return f"<span>PSNR {decibels(view.psnr_after)} dB</span>"
    change = view.psnr_after - view.psnr_before
    suffix = f" ({_signed(f'{change:+.2f}')})" if math.isfinite(change) else ""
    return f"<span>PSNR {decibels(view.psnr_before)} → {decibels(view.psnr_after)} dB{suffix}</span>"


def _figure(
    title: str, view: str, rgb: np.ndarray, css: str = "", stack: bool = False, below: str = ""
) -> str:
    height, width, _ = rgb.shape
    alt = escape(f"{view}: {title}")
    image = f'<img src="{data_uri(rgb)}" alt="{alt}" width="{width}" height="{height}">'
    image = f'<div class="stack">{image}</div>' if stack else image
    return f'<figure class="{css}">{image}{below}<figcaption>{escape(title)}</figcaption></figure>'


def _colour_bar(top: float) -> str:
    return (
        f'<div class="bar" style="background:linear-gradient(to right,{",".join(hex_colors())})" role="img" '
        f'aria-label="Colours from black at 0 to yellow at {top:.3g} and above"></div>'
        f'<div class="range soft"><span>0</span><span>≥ {top:.3g}</span></div>'
    )
