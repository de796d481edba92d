"""The part of results.md on the study time: PSNR of each method in the same seconds."""

from __future__ import annotations

from collections import defaultdict
from pathlib import Path
from statistics import fmean

from method_charts import time_chart


def in_time(rows: list[dict], charts: Path) -> str:
    """A chart and a table for each scene; empty without rows."""
    by_scene: dict[str, list[dict]] = defaultdict(list)
    for row in rows:
        if row["study"] == "time":
            by_scene[row["scene"]].append({**row, "method": row["run"].split()[0]})
    parts = [part for scene, those in by_scene.items() for part in of_scene(scene, those, charts)]
    return (
        "\n".join([*parts, nearness([row for those in by_scene.values() for row in those])]) if parts else ""
    )


def of_scene(scene: str, rows: list[dict], charts: Path) -> list[str]:
    """The lines of one scene: its chart, and PSNR, LPIPS and steps of each method in each time."""
    methods = sorted({row["method"] for row in rows}, key=lambda name: (name != "removal", name))
    limits = sorted({row["time"]["asked"] for row in rows})
    curves = {
        name: sorted(
            (row["time"]["used"], row["psnr"], row["lpips"]) for row in rows if row["method"] == name
        )
        for name in methods
    }
    before = rows[0]["before"]
    time_chart(
        curves,
        before["psnr"],
        f"{scene}, 10 % of {before['count']:,} Gaussians",
        charts / f"time-{scene}.svg",
    )
    lines = [
        f"![PSNR and LPIPS over seconds](results/time-{scene}.svg)",
        "",
        f"| {scene} (PSNR before {before['psnr']:.2f}) | {' | '.join(methods)} |",
    ]
    lines.append("|---" * (1 + len(methods)) + "|")
    for limit in limits:
        found = {row["method"]: row for row in rows if row["time"]["asked"] == limit}
        lines.append(f"| {limit:g} s | " + " | ".join(cell(found.get(name)) for name in methods) + " |")
    return [*lines, ""]


def cell(row: dict | None) -> str:
    """PSNR, LPIPS, and the steps that it took."""
    return f"{row['psnr']:.2f}, {row['lpips']:.3f} ({row['iterations']:,} steps)" if row else ""


def nearness(rows: list[dict]) -> str:
    """How near the seconds that were used come to those that were foreseen, in a sentence."""
    errors = [row["time"]["used"] / row["time"]["foreseen"] - 1 for row in rows]
    over = sum(row["time"]["used"] > row["time"]["asked"] for row in rows)
    return (
        f"The seconds used differed from those foreseen by {fmean(map(abs, errors)):.0%} in the mean,"
        f" {min(errors):+.0%} to {max(errors):+.0%}; {over} of {len(rows)} jobs took longer than asked.\n"
    )
