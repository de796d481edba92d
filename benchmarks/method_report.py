"""Writes results.md from the rows of benchmarks/methods.py: the two tables of the paper, its sweep of lambda_F, and PSNR over count."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable
from pathlib import Path
from statistics import fmean

from method_charts import curve_chart, pareto_chart
from method_scenes import GENERATED
from time_report import time_part

SCENARIOS = ("Scenario A", "Scenario B", "SVR-GS")  # Table 2 of the paper
PAPER, BASE, RIVAL = "SVR-GS", "3DGS", "MaskGS alpha"
FIGURES = ("psnr", "ssim", "lpips", "flip", "count", "bytes", "seconds", "ms_per_frame")
HEAD = "| {} | PSNR | SSIM | LPIPS | FLIP | Gaussians | 3DGS over it | MB | seconds | ms a frame |"
INTRO = """# Every method in the same trainer

`benchmarks/methods.py --show docs` makes this page from the rows in [results/rows.jsonl](results/rows.jsonl). The same program makes the rows:

{commands}

Each row is one run of `svrgs train` or `svrgs prune` from the command line, on the processor alone. Test views are every 8th photograph.
`--schedule` scales every milestone and step count, but not the spacing of densifications (100 steps) and of opacity resets (3 000 steps): they depend
on the number of views that were seen. With fewer steps, masks learn faster by the same factor. Weights of the loss stay the same. `--shrink` makes
the photographs smaller. What each method is, and how it differs from its source: [methods.md](methods.md).
"""


def write_report(rows: list[dict], folder: Path):
    """Writes `folder`/results.md and its charts in `folder`/results, from the rows that have figures."""
    rows = averaged(row for row in rows if "error" not in row)
    charts = folder / "results"
    charts.mkdir(parents=True, exist_ok=True)
    findings = charts / "findings.md"  # written by hand
    parts = [
        INTRO.format(commands=commands(rows)),
        findings.read_text() if findings.exists() else "",
        table_part(rows),
        scenario_part(rows),
        printed_part(rows),
    ]
    parts += [few_part(rows), schedule_part(rows), lambda_part(rows, charts), pareto_part(rows, charts), time_part(rows, charts), ablation_part(rows)]
    (folder / "results.md").write_text("\n".join(part for part in parts if part))


def commands(rows: list[dict]) -> str:
    """The commands that make the rows."""
    kinds: dict[tuple, set] = defaultdict(set)
    for row in rows:
        kinds[row["study"], row["schedule"], row["trained"], row["shrink"]].add(row["scene"])
    lines = []
    for (study, schedule, trained, shrink), scenes in sorted(kinds.items()):
        named = " ".join(f"--scene {scene}" if scene in GENERATED else f"--scene {scene}=DIR" for scene in sorted(scenes))
        pruned = f" --trained {trained:g}" if study in ("pareto", "ablation", "schedules", "time") and trained != schedule else ""
        lines.append(f"    .venv/bin/python benchmarks/methods.py --study {study} --schedule {schedule:g}{pruned} --shrink {shrink} {named}")
    return "\n".join(lines)


def groups(rows: Iterable[dict], *names: str) -> dict[tuple, list[dict]]:
    """The rows by their values of these keys."""
    found: dict[tuple, list[dict]] = defaultdict(list)
    for row in rows:
        found[tuple(row[name] for name in names)].append(row)
    return dict(found)


def averaged(rows: Iterable[dict]) -> list[dict]:
    """One row per run: the mean figures of its seeds, curves and `before` of the first seed, and `spread`, half the range of PSNR."""
    means = []
    for group in groups(rows, "study", "scene", "run", "schedule", "trained", "shrink").values():
        psnr = [row["psnr"] for row in group]
        figures = {name: mean(group, name) for name in FIGURES} | {"count": round(mean(group, "count"))}
        means.append({**group[0], **figures, "spread": (max(psnr) - min(psnr)) / 2, "seeds": len(group)})
    return means


def mean(rows: list[dict], name: str) -> float | None:
    values = [row[name] for row in rows if row.get(name) is not None]
    return fmean(values) if values else None


def line(label: str, rows: list[dict], base: list[dict]) -> str:
    """One line of a table: means over scenes. The ratio of counts is a ratio of sums, as in the paper."""
    lpips, count = mean(rows, "lpips"), mean(rows, "count")
    ratio = f"{mean(base, 'count') / count:.2f}" if base else ""
    return (
        f"| {label} | {psnr_of(rows)} | {mean(rows, 'ssim'):.4f} | {'no weights' if lpips is None else f'{lpips:.4f}'} | {mean(rows, 'flip'):.4f} "
        f"| {count:,.0f} | {ratio} | {mean(rows, 'bytes') / 1e6:.1f} | {mean(rows, 'seconds'):.0f} | {mean(rows, 'ms_per_frame'):.1f} |"
    )


def psnr_of(rows: list[dict]) -> str:
    """The mean PSNR in dB; for one run with several seeds also half its range."""
    several = len(rows) == 1 and rows[0]["seeds"] > 1
    return f"{mean(rows, 'psnr'):.2f}" + (f" ± {rows[0]['spread']:.2f}" if several else "")


def table(rows: list[dict], title: str, labels: Iterable[str] | None = None) -> list[str]:
    by_run = groups(rows, "run")
    base = by_run.get((BASE,), [])
    labels = [label for label in (labels or [run for (run,) in by_run]) if (label,) in by_run]
    return [HEAD.format(title), "|---" * 10 + "|", *(line(label, by_run[label,], base) for label in labels)]


def table_part(rows: list[dict]) -> str:
    """Table 1 of the paper, for every schedule: each scene, and the mean of the scenes that have all runs."""
    lines = ["## From the sparse points", ""]
    for (schedule,), those in groups((r for r in rows if r["study"] == "table"), "schedule").items():
        lines += [f"Schedule {schedule:g}.", ""]
        by_scene = groups(those, "scene", "shrink")
        runs = max((list(groups(scene_rows, "run")) for scene_rows in by_scene.values()), key=len)
        for (scene, shrink), scene_rows in by_scene.items():
            lines += [*table(scene_rows, f"{scene}, photographs 1/{shrink}", [run for (run,) in runs]), ""]
        whole = complete(those)
        if len(groups(whole, "scene")) > 1:
            lines += [*table(whole, f"mean of {len(groups(whole, 'scene'))} scenes", [run for (run,) in runs]), "", ratios(whole), ""]
    return "\n".join(lines)


def complete(rows: list[dict]) -> list[dict]:
    """The rows of the scenes that have all runs."""
    by_scene = groups(rows, "scene", "shrink")
    runs = len(groups(rows, "run"))
    return [row for those in by_scene.values() if len(groups(those, "run")) == runs for row in those]


def ratios(rows: list[dict]) -> str:
    """A sentence that compares SVR-GS with its rivals in the terms of the paper."""
    by_run = groups(rows, "run")
    if not all((name,) in by_run for name in (PAPER, BASE, RIVAL)):
        return ""
    sentences = []
    for other in (RIVAL, BASE):
        fewer = mean(by_run[other,], "count") / mean(by_run[PAPER,], "count")
        drop = mean(by_run[PAPER,], "psnr") - mean(by_run[other,], "psnr")
        sentences.append(f"{fewer:.2f} times fewer Gaussians than {other} at {drop:+.2f} dB")
    return f"SVR-GS here: {'; '.join(sentences)}. The paper: 1.79 times fewer than MaskGS at -0.50 dB, 5.63 times fewer than 3DGS at -0.40 dB."


def printed_part(rows: list[dict]) -> str:
    """The paper's printed weights of the image loss next to the usual ones, on the scenes that have both."""
    printed = groups((row for row in rows if row["study"] == "printed"), "scene", "schedule", "shrink")
    lines = ["## The printed weights: L1 + (1 - SSIM)", ""] if printed else []
    for key, those in printed.items():
        usual = [row for row in rows if row["study"] == "table" and (row["scene"], row["schedule"], row["shrink"]) == key]
        shown = [row for row in usual if row["run"] in (BASE, RIVAL, *SCENARIOS)]
        lines += [*table([*shown, *those], f"{key[0]}, schedule {key[1]:g}, photographs 1/{key[2]}"), ""]
    return "\n".join(lines)


def scenario_part(rows: list[dict]) -> str:
    """Table 2 of the paper: its scenarios."""
    lines = ["## Scenarios A and B", ""]
    for (schedule,), those in groups((r for r in rows if r["study"] == "table"), "schedule").items():
        whole = [row for row in complete(those) if row["run"] in SCENARIOS]
        if set(SCENARIOS) == {row["run"] for row in whole}:
            lines += [*table(whole, f"mean over {len(groups(whole, 'scene'))} scenes, schedule {schedule:g}", SCENARIOS), ""]
    return "\n".join(lines) if len(lines) > 2 else ""


def few_part(rows: list[dict]) -> str:
    """PSNR of the default and its nearest rivals at few Gaussians, for several schedules."""
    rows = [{**row, "share": float(row["run"].split()[1])} for row in named(rows) if row["study"] == "schedules"]
    if not rows:
        return ""
    columns = sorted(groups(rows, "schedule", "method"), key=lambda column: (column[0], column[1] != "removal", column[1]))
    lines = ["## Few Gaussians: the default and its nearest rivals, with short and long schedules", ""]
    lines += [
        "| scene (PSNR before) | kept | " + " | ".join(f"{method}, {schedule:g}" for schedule, method in columns) + " |",
        "|---" * (2 + len(columns)) + "|",
    ]
    cases = groups(rows, "scene", "share")
    for scene, share in sorted(cases, key=lambda case: (case[0], -case[1])):
        those = cases[scene, share]
        found = groups(those, "schedule", "method")
        cells = " | ".join(psnr_of(found[column]) if column in found else "" for column in columns)
        lines.append(f"| {scene} ({those[0]['before']['psnr']:.2f}) | {100 * share:g} % | {cells} |")
    return "\n".join([*lines, ""])


def schedule_part(rows: list[dict]) -> str:
    """Runs of one scene with several schedules, side by side: they show whether a short schedule ranks methods as a longer one does."""
    lines = ["## One scene, several schedules", ""]
    for (scene, shrink), those in groups((r for r in rows if r["study"] == "table"), "scene", "shrink").items():
        schedules = sorted(groups(those, "schedule"))
        if len(schedules) < 2:
            continue
        by_run = {run: {row["schedule"]: row for row in group} for (run,), group in groups(those, "run").items()}
        shared = {run: found for run, found in by_run.items() if len(found) == len(schedules)}
        heads = "".join(f" schedule {s:g}: Gaussians | PSNR | place by PSNR, by count |" for (s,) in schedules)
        lines += [f"| {scene}, photographs 1/{shrink} |{heads}", "|---" * (1 + 3 * len(schedules)) + "|"]
        for run, found in shared.items():
            cells = [
                f"{found[s]['count']:,} | {psnr_of([found[s]])} | {place(run, shared, s, 'psnr', -1)}, {place(run, shared, s, 'count', 1)}"
                for (s,) in schedules
            ]
            lines.append(f"| {run} | {' | '.join(cells)} |")
        lines.append("")
    return "\n".join(lines) if len(lines) > 2 else ""


def place(run: str, runs: dict[str, dict], schedule: float, figure: str, sign: int) -> int:
    """The rank of a run by a figure within a schedule: 1 for the largest (sign -1) or for the smallest (sign 1)."""
    return 1 + sum(sign * found[schedule][figure] < sign * runs[run][schedule][figure] for found in runs.values())


def lambda_part(rows: list[dict], charts: Path) -> str:
    """The sweep of lambda_F: counts and PSNR over iterations."""
    lines = ["## Sweep of λ_F with SVR-GS", ""]
    for (scene, schedule), those in groups((r for r in rows if r["study"] == "lambda"), "scene", "schedule").items():
        name = f"lambda-{scene}-{schedule:g}"
        curve_chart([(row["run"].replace("lambda_F", "λ_F"), row["curves"]) for row in those], f"{scene}, schedule {schedule:g}", charts / f"{name}.svg")
        lines += [*table(those, f"{scene}, schedule {schedule:g}"), "", f"![count and PSNR over iterations](results/{name}.svg)", ""]
    return "\n".join(lines) if len(lines) > 2 else ""


def pareto_part(rows: list[dict], charts: Path) -> str:
    """PSNR over the number of Gaussians, one line per method."""
    lines = ["## Pruning a trained scene: PSNR of every method at equal counts", ""]
    for (scene, schedule, shrink), those in groups((r for r in rows if r["study"] == "pareto"), "scene", "schedule", "shrink").items():
        name = f"pareto-{scene}-{schedule:g}"
        before = those[0]["before"]
        curves = {method: sorted((row["count"], row["psnr"]) for row in group) for (method,), group in groups(named(those), "method").items()}
        pareto_chart(curves, (before["count"], before["psnr"]), f"{scene}, schedule {schedule:g}, photographs 1/{shrink}", charts / f"{name}.svg")
        lines += [f"![{scene}](results/{name}.svg)", "", "| method and strength | Gaussians | PSNR | seconds |", "|---|---|---|---|"]
        ordered = sorted(those, key=lambda row: (row["run"].split()[0], -row["count"]))
        lines += [f"| {row['run']} | {row['count']:,} | {psnr_of([row])} | {row['seconds']:.0f} |" for row in ordered]
        lines += [f"| before | {before['count']:,} | {before['psnr']:.2f} | |", ""]
    return "\n".join(lines) if len(lines) > 2 else ""


def ablation_part(rows: list[dict]) -> str:
    """The effect of each part of `removal`: PSNR at equal count."""
    lines = ["## Parts of `removal`: PSNR without them, at equal count", ""]
    for (scene, schedule), those in groups((r for r in rows if r["study"] == "ablation"), "scene", "schedule").items():
        counts = sorted(groups(those, "count"), reverse=True)
        lines += [f"| {scene}, schedule {schedule:g} | " + " | ".join(f"{count:,} Gaussians" for (count,) in counts) + " |", "|---" * (1 + len(counts)) + "|"]
        for (part,), group in groups(({**row, "part": row["run"].rpartition(" ")[0]} for row in those), "part").items():
            found = groups(group, "count")
            lines.append(f"| {part} | " + " | ".join(f"{mean(found[count], 'psnr'):.2f}" if count in found else "" for count in counts) + " |")
        lines.append("")
    return "\n".join(lines) if len(lines) > 2 else ""


def named(rows: list[dict]) -> list[dict]:
    """The rows with the key `method`, taken from the name of the run."""
    return [{**row, "method": row["run"].split()[0]} for row in rows]
