"""The end of a farm job: one table and one chart over all its tasks, as a page, as Markdown and as JSON."""

from __future__ import annotations

import shlex
from collections import defaultdict
from collections.abc import Callable
from html import escape
from pathlib import Path
from statistics import fmean
from typing import Any

from ... import __version__
from ...files.atomic import write_bytes, write_json
from ...prune.likeness import assumed_drop
from ...prune.report.point_chart import Axis, Point, chart, front
from ...prune.report.style import CSS
from ...system.errors import FormatError, SceneError
from ...system.foreign import own
from ...system.memory import size_text
from .farm_job import FarmJob, Task

COLUMNS: dict[str, Callable[[dict[str, Any]], str]] = {  # title -> text of a row
    "task": lambda row: row["name"],
    "method": lambda row: row["method"],
    "measured against": lambda row: row["against"],
    "Gaussians": lambda row: f"{row['count']:,}",
    "kept": lambda row: f"{row['kept']:.1%}",
    "size": lambda row: size_text(row["bytes"]),
    "PSNR, dB": lambda row: _text(row["psnr"], 2),
    "loss, dB": lambda row: _text(row["loss"], 2),
    "SSIM": lambda row: _text(row["ssim"], 4),
    "seconds": lambda row: f"{row['seconds']:.0f}",
}


def summarise(job: FarmJob) -> dict[str, Any]:
    """Writes report/index.html, table.md and table.json into the folder of the job. Returns the rows, those
    over all scenes, names of tasks that are not done, and the page. Raises SceneError if no task is done."""
    results = [(task, job.result(task)) for task in job.tasks]
    rows = [_row(job, task, found["result"]) for task, found in results if found]
    missing = [task.name for task, found in results if not found]
    if not rows:
        raise SceneError(
            f"{job.folder}: none of its {len(missing)} tasks is done; do them first with svrgs farm run"
        )
    means, page = _means(rows), own(job.folder, "report", "index.html")
    facts = {"tasks": rows, "over_all_scenes": means, "missing": missing}
    write_json(own(job.folder, "report", "table.json"), facts, indented=True)
    _write(own(job.folder, "report", "table.md"), "\n".join(_markdown(rows)) + "\n")
    _write(page, _page(rows, means, missing))
    return facts | {"report": str(page)}


def _row(job: FarmJob, task: Task, result: dict[str, Any]) -> dict[str, Any]:
    """Raises FormatError."""
    files = [str(job.options(task).scene), str(job.out(task))]
    facts = {"name": task.name, "scene": task.scene, "target": task.options.get("target"), "files": files}
    try:
        before, after = result["before"], result["after"]
        facts |= {name: after.get(name) for name in ("count", "bytes", "psnr", "ssim", "lpips", "flip")}
        facts |= {name: result[name] for name in ("method", "seconds")}
        facts["against"] = "its own pictures" if before.get("psnr") is None else "photographs"
        return facts | {"kept": after["count"] / before["count"], "loss": _loss(before, after)}
    except (KeyError, TypeError, AttributeError, ZeroDivisionError):
        raise FormatError(f"{job.result_path(task)}: is damaged; delete it, and do the task again") from None


def _text(value: float | None, digits: int) -> str:
    return "not measured" if value is None else f"{value:.{digits}f}"


def _loss(before: dict[str, Any], after: dict[str, Any]) -> float | None:
    """The loss of PSNR in dB against the photographs. Without photographs: what a scene would lose whose own
    error is PHOTOGRAPHED. None: not measured."""
    if after.get("psnr") is None:
        return None
    if before.get("psnr") is not None:
        return before["psnr"] - after["psnr"]
    return assumed_drop(after["psnr"])


def _means(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Means over the scenes of each method and target that all scenes have; over those that were measured
    against photographs apart from the others, whose loss is one that is assumed."""
    ways: dict[tuple, list[dict[str, Any]]] = defaultdict(list)
    for row in _measured(rows):
        ways[row["method"], row["target"], row["against"]].append(row)
    scenes = {
        row["against"]: {one["scene"] for one in rows if one["against"] == row["against"]} for row in rows
    }
    names = ("kept", "loss", "seconds")
    return [
        {"method": method, "target": target, "against": against, "scenes": len(some)}
        | {name: fmean(row[name] for row in some) for name in names}
        for (method, target, against), some in ways.items()
        if {row["scene"] for row in some} == scenes[against]
    ]


def _measured(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    return [row for row in rows if row["loss"] is not None]


def _chart(rows: list[dict[str, Any]], means: list[dict[str, Any]]) -> str:
    """Loss over the share that is kept: means over the scenes, and single tasks as rings."""
    both = len({row["against"] for row in means}) > 1
    label = lambda row: f"{row['method']}, {row['against']}" if both else row["method"]
    named = [Point(100 * row["kept"], row["loss"], label(row)) for row in means]
    single = [Point(100 * row["kept"], row["loss"], "") for row in _measured(rows)]
    x, y = Axis("Gaussians kept, %", from_zero=True), Axis("loss of PSNR, dB")
    title = "Loss over what is kept: means over all scenes; rings: single tasks"
    return chart(title, named or single, x, y, front(named), single if named else ())


def _markdown(rows: list[dict[str, Any]]) -> list[str]:
    head = [f"| {' | '.join(COLUMNS)} |", f"|---|---|---|{'---:|' * (len(COLUMNS) - 3)}"]
    cells = lambda row: (text(row).replace("|", r"\|") for text in COLUMNS.values())
    return head + [f"| {' | '.join(cells(row))} |" for row in rows]


def _page(rows: list[dict[str, Any]], means: list[dict[str, Any]], missing: list[str]) -> str:
    body_rows = "".join(f"<tr>{_cells(row)}</tr>" for row in rows)
    head = "".join(f"<th>{escape(title)}</th>" for title in COLUMNS)
    lost = f'<p class="note">Not done: {escape(", ".join(missing))}</p>' if missing else ""
    table = f"<table><thead><tr>{head}</tr></thead><tbody>{body_rows}</tbody></table>"
    table = f'<div class="scroll">{table}</div>'
    body = (
        f'<h1>{len(rows)} tasks</h1>{lost}<div class="card">{_chart(rows, means)}</div><h2>All tasks</h2><div'
        f' class="card">{table}</div>'
    )
    policy = "default-src 'none'; style-src 'unsafe-inline'"
    return (
        '<!doctype html><html lang="en"><head><meta charset="utf-8"><meta'
        f' http-equiv="Content-Security-Policy" content="{policy}"><title>SVR-GS farm'
        f" job</title><style>{CSS}</style></head><body>{body}<footer>SVR-GS"
        f" {__version__}</footer></body></html>"
    )


def _cells(row: dict[str, Any]) -> str:
    """The cells of a task. Its name opens to how both scenes are looked at."""
    name, *others = (escape(text(row)) for text in COLUMNS.values())
    command = escape(shlex.join(["svrgs", "view", *row["files"]]))
    opens = f"<details><summary>{name}</summary><code>{command}</code></details>"
    return "".join(f"<td>{cell}</td>" for cell in (opens, *others))


def _write(path: Path, text: str):
    write_bytes(path, text.encode(errors="replace"))
