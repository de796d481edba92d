"""Writes results.md from the rows of benchmarks/methods.py.

The page is docs/results/page.md, written by hand, in which a line {name} stands for a part that is made here
from the rows.
"""

from __future__ import annotations

import json
from collections import defaultdict
from collections.abc import Callable, Iterable
from pathlib import Path
from statistics import fmean

from method_charts import curve_chart, looks_chart, pareto_chart
from method_scenes import GENERATED
from method_studies import OWN_RATES, PRUNED
from time_report import in_time

DEFAULT = "removal"  # the default method
BASE, RIVAL, PAPER = "3DGS", "MaskGS alpha", "SVR-GS"
TABLE_ONE = (BASE, "LightGaussian", "Compact3DGS", RIVAL, PAPER)
PAPER_RUNS = (BASE, RIVAL, PAPER, "Scenario A", "Scenario B")  # the columns of the paper's tables
FIGURES = ("psnr", "ssim", "lpips", "flip", "count", "bytes", "seconds", "ms_per_frame")
QUOTED = ("equal", "pareto")  # studies that the README quotes
LOSSES = {"table": "usual", "lambda": "usual", "printed": "printed"}  # weights of the image loss, by study


def write_report(rows: list[dict], folder: Path):
    """Writes `folder`/results.md and its charts in `folder`/results, from the rows that have figures."""
    rows = averaged(row for row in rows if "error" not in row)
    charts = folder / "results"
    page = (charts / "page.md").read_text().splitlines()
    made = {f"{{{name}}}": part for name, part in PARTS.items()}
    (folder / "results.md").write_text(
        "".join((made[line](rows, charts) if line in made else line) + "\n" for line in page)
    )


def command(rows: list[dict], charts: Path) -> str:
    """The command that makes the rows anew, and how long they took."""
    captures = sorted({row["scene"] for row in rows} - set(GENERATED))
    folders = " ".join(f"--scene {scene}=DIR" for scene in captures)
    whole, quoted = (
        sum(row["wall_seconds"] * row["seeds"] for row in some) / 3600
        for some in (rows, [row for row in rows if row["study"] in QUOTED and row["schedule"] == 0.1])
    )
    return f"""    .venv/bin/python benchmarks/methods.py --page --rows build/rows.jsonl {folders}

That takes about {whole:.0f} hours on two cores, what the README quotes of it about {quoted:.0f}
(`--study {" --study ".join(QUOTED)}`). It says how long the rest takes, and goes on where it
stopped. `--part 1/3`, `2/3` and `3/3` divide it among three machines, `--join` joins their rows; `--study`
runs a part."""


def groups(rows: Iterable[dict], *names: str) -> dict[tuple, list[dict]]:
    """The rows by their values of these keys."""
    found: dict[tuple, list[dict]] = defaultdict(list)
    for row in rows:
        found[tuple(row[name] for name in names)].append(row)
    return dict(found)


def averaged(rows: Iterable[dict]) -> list[dict]:
    """One row per run: the mean figures of its seeds, curves of the first seed, and `spread`, half the range
    of PSNR."""
    means = []
    for group in groups(rows, "study", "scene", "run", "schedule", "trained", "start", "shrink").values():
        psnr = [row["psnr"] for row in group]
        figures = {name: mean(group, name) for name in FIGURES} | {"count": round(mean(group, "count"))}
        means.append(
            {
                **group[0],
                **figures,
                "before": before_of(group),
                "spread": half_range(psnr),
                "seeds": len(group),
            }
        )
    return means


def before_of(rows: list[dict]) -> dict | None:
    """Of the scenes that were pruned, one a seed: mean count and PSNR, and half the range of PSNR. None if
    nothing was pruned."""
    scenes = [row["before"] for row in rows if row.get("before")]
    if not scenes:
        return None
    psnr = [scene["psnr"] for scene in scenes]
    return {
        **scenes[0],
        "count": round(fmean(scene["count"] for scene in scenes)),
        "psnr": fmean(psnr),
        "spread": half_range(psnr),
        "seeds": len(set(psnr)),
    }


def half_range(values: list[float]) -> float:
    return (max(values) - min(values)) / 2


def mean(rows: list[dict], name: str) -> float | None:
    values = [row[name] for row in rows if row.get(name) is not None]
    return fmean(values) if values else None


def psnr_of(row: dict) -> str:
    """PSNR in dB; of several seeds their mean and half their range."""
    return f"{row['psnr']:.2f}" + (f" ± {row['spread']:.2f}" if row["seeds"] > 1 else "")


def table(head: list[str], lines: Iterable[list[str]]) -> str:
    return "\n".join(f"| {' | '.join(cells)} |" for cells in [head, ["---"] * len(head), *lines]) + "\n"


def case(row: dict) -> str:
    """What a figure rests on: scene, size of the photographs, schedule."""
    shrink = "" if row["shrink"] == 1 else f", photographs 1/{row['shrink']}"
    trained = f", {row['start']} scene of schedule {row['trained']:g}" if row["study"] in PRUNED else ""
    return f"{row['scene']}{shrink}, schedule {row['schedule']:g}{trained}"


def pruned(rows: list[dict], study: str) -> list[dict]:
    """The rows of a study that prunes, with the keys `method` and `share`: the share of the target, 1 without
    one."""
    found = ((row, *row["run"].rpartition(" ")[::2]) for row in rows if row["study"] == study)
    return [
        {**row, "method": method or share, "share": float(share) if method else 1.0}
        for row, method, share in found
    ]


def equal(rows: list[dict], charts: Path) -> str:
    """The recipe of the default with other rankings, and with nothing removed."""
    rows = sorted(pruned(rows, "equal"), key=lambda row: (row["scene"], row["schedule"]))
    alone = {"steps of 3dgs": "plain steps", DEFAULT: "`removal`: GaussianPOP's ranking"}
    rankings = [name for (name,) in groups(rows, "method") if name not in alone]
    columns = alone | {name: f"that of `{name}`" for name in rankings}
    return by_share(rows, columns)


def rivals(rows: list[dict], charts: Path) -> str:
    """The same scenes with each rival as it is, with MCMC, and with the default by the rates of 3DGS."""
    rows = pruned(rows, "pareto")
    places = {(row["scene"], row["shrink"], row["trained"]) for row in rows if row["method"] == OWN_RATES}
    rows = [row for row in rows if (row["scene"], row["shrink"], row["trained"]) in places]
    names = {name for (name,) in groups(rows, "method")}
    first = {"3dgs": "plain steps", DEFAULT: f"`{DEFAULT}`", OWN_RATES: "its passes, rates of 3DGS"}
    last = {"mcmc": "trained to the number by MCMC"}
    others = {name: f"`{name}`" for name in sorted(names - {*first, *last})}
    curves = {
        name: sorted((row["count"], row["psnr"], row["lpips"]) for row in those)
        for (name,), those in groups(rows, "method").items()
    }
    pareto_chart(curves, case(rows[0]), charts / "rivals.svg")
    picture = "\n![PSNR and LPIPS over the number of Gaussians](results/rivals.svg)\n"
    return by_share(rows, first | others | last) + picture


def full_size(rows: list[dict], charts: Path) -> str:
    """Real captures with photographs in full size."""
    return beside_rivals([row for row in pruned(rows, "pareto") if row["shrink"] == 1])


def to_the_end(rows: list[dict], charts: Path) -> str:
    """Scenes that were trained with all steps."""
    return beside_rivals([row for row in pruned(rows, "pareto") if row["trained"] == 1])


def beside_rivals(rows: list[dict]) -> str:
    """A table of the default and each rival."""
    others = sorted({name for (name,) in groups(rows, "method")} - {"3dgs", DEFAULT})
    columns = {"3dgs": "plain steps", DEFAULT: f"`{DEFAULT}`"} | {name: f"`{name}`" for name in others}
    return by_share(rows, columns)


def by_share(rows: list[dict], columns: dict[str, str]) -> str:
    """A table of PSNR and LPIPS with a line for each scene and share. columns: heading of each method."""
    lines = []
    for those in groups(rows, "scene", "schedule", "shrink", "trained", "start").values():
        for (share,), group in sorted(groups(those, "share").items(), reverse=True):
            found = {row["method"]: row for row in group}
            cells = (perceived(found[name]) if name in found else "" for name in columns)
            lines.append([case(group[0]), f"{100 * share:g} %", pixels(group[0]), *cells])
    return table(["scene", "kept", "pixels a Gaussian", *columns.values()], lines)


def published(rows: list[dict], charts: Path) -> str:
    """Rivals with their published steps, and the default with as many."""
    rows = pruned(rows, "published")
    names = sorted((name for (name,) in groups(rows, "method")), key=lambda name: (name.count("5 k"), name))
    return by_share(rows, {name: f"`{name.replace(', ', '`, ')}" for name in names})


def ablation(rows: list[dict], charts: Path) -> str:
    """The default with one part of its recipe changed at a time."""
    rows = pruned(rows, "ablation")
    names = [name for (name,) in groups(rows, "method") if name != DEFAULT]
    return by_share(rows, {DEFAULT: "as it is"} | {name: name for name in sorted(names)})


def looks(rows: list[dict], charts: Path) -> str:
    """Looks at what stays: seconds, the share of others than with the exact look, PSNR in the end."""
    lines, points = [], {}
    ends = {(row["method"], row["share"]): row for row in pruned(rows, "looks")}
    shares = sorted({share for _, share in ends}, reverse=True)
    for look in map(json.loads, (charts / "looks.jsonl").read_text().splitlines()):
        name, differs = look["look"], look["differs"]
        found = [ends.get((name, share)) for share in shares]
        seconds = f"{look['seconds']:.2g}"
        cells = [f"{value:.1%}".replace("%", " %") for value in differs.values()]
        lines.append([name, seconds, *cells, *(perceived(row) if row else "" for row in found)])
        for share, row in zip(shares, found, strict=True):
            if row:
                points.setdefault(f"{100 * share:g} %", {})[name] = (look["seconds"], row["psnr"])
    looks_chart(points, charts / "looks.svg")
    kept = [f"{100 * float(share):g} %" for share in differs]
    ended = [f"PSNR and LPIPS with {100 * share:g} %" for share in shares]
    head = ["look", "seconds", *(f"others of {share}" for share in kept), *ended]
    return table(head, lines) + "\n![PSNR over the seconds of a look](results/looks.svg)\n"


def skips(rows: list[dict], charts: Path) -> str:
    """What skips work of a whole training: seconds and PSNR against the plain one, a line for each scene."""
    names = {"coarse": "half size at first", "views": "easy views left out", "coarse, views": "both"}
    lines = []
    for those in groups(
        (row for row in rows if row["study"] == "skips"), "scene", "schedule", "shrink"
    ).values():
        found = {row["run"]: row for row in those}
        plain = found["plain"]
        cells = (against(found[name], plain) if name in found else "" for name in names)
        lines.append([case(plain), f"{plain['seconds']:.0f} s, {counted(plain)}", *cells])
    return table(["scene", "plain", *names.values()], lines)


def against(row: dict, plain: dict) -> str:
    """Seconds, PSNR and LPIPS of a run, as changes of another one's."""
    change = f"{row['seconds'] / plain['seconds'] - 1:+.0%}, {row['psnr'] - plain['psnr']:+.2f} dB".replace(
        "%", " %"
    )
    return f"{change}, {row['lpips'] - plain['lpips']:+.3f}"


def levels(rows: list[dict], charts: Path) -> str:
    """A whole training with each SIMD level."""
    lines = []
    for those in groups(
        (row for row in rows if row["study"] == "levels"), "scene", "schedule", "shrink"
    ).values():
        lines += [[case(row), row["run"], counted(row)] for row in those]
    return table(["scene", "SIMD level", "Gaussians (pixels a Gaussian) at PSNR, LPIPS"], lines)


def perceived(row: dict) -> str:
    """PSNR and LPIPS."""
    return f"{psnr_of(row)}, {row['lpips']:.3f}"


def other_figures(rows: list[dict], charts: Path) -> str:
    """PSNR, LPIPS, SSIM and FLIP of the default at each share, and of the same number of further steps
    without pruning."""
    lines = []
    for those in groups(pruned(rows, "pareto"), "scene", "schedule", "shrink", "trained", "start").values():
        base = [row for row in those if row["share"] == 1]
        ours = sorted((row for row in those if row["method"] == DEFAULT), key=lambda row: -row["share"])
        for row in [*base, *ours]:
            kept = "no pruning" if row["share"] == 1 else f"{100 * row['share']:g} %"
            lines.append([case(row), kept, *four_figures(row)])
    return table(["scene", "kept", *FOUR], lines)


def texture(rows: list[dict], charts: Path) -> str:
    """The default with nothing removed, and with a tenth that learns from something else, too."""
    lines = []
    for row in sorted(pruned(rows, "texture"), key=lambda row: (row["scene"], -row["share"])):
        what = "as it is" if row["method"] == DEFAULT else row["method"]
        lines.append([case(row), f"{100 * row['share']:g} %", what, *four_figures(row)])
    return table(["scene", "kept", "steps learn from", *FOUR], lines)


def degrees(rows: list[dict], charts: Path) -> str:
    """The default with fewer SH bands, as SPZ files."""
    lines = []
    for row in sorted(pruned(rows, "degrees"), key=lambda row: (row["scene"], row["share"] > 0.1)):
        figures = f"{100 * row['share']:g} %", f"{row['bytes'] / 1e3:.0f}", *four_figures(row)
        lines.append([case(row), row["method"].removeprefix("SH "), *figures])
    return table(["scene", "SH degree", "kept", "kB", *FOUR], lines)


def sizes(rows: list[dict], charts: Path) -> str:
    """The default with fewer SH bands, as SPZ files of one size."""
    lines = []
    for row in (row for row in rows if row["study"] == "sizes"):
        degree, size = row["run"].removeprefix("SH ").split(", ")
        figures = f"{row['count']:,}", f"{row['bytes'] / 1e3:.0f}", *four_figures(row)
        lines.append([case(row), size, degree, *figures])
    return table(["scene", "at most", "SH degree", "Gaussians", "kB", *FOUR], lines)


FOUR = ("PSNR", "LPIPS", "SSIM", "FLIP")


def four_figures(row: dict) -> list[str]:
    """Those of FOUR."""
    return [psnr_of(row), *(f"{row[name.lower()]:.4f}" for name in FOUR[1:])]


def points(rows: list[dict], charts: Path) -> str:
    """From the sparse points: PSNR and number of Gaussians of every method, a column per scene and schedule
    with more than one of them."""
    rows = [row for row in rows if row["study"] == "table"]
    found = groups(rows, "scene", "shrink", "schedule")
    columns = {key: those for key, those in found.items() if len(those) > 1}
    lines = []
    for (run,), group in groups(rows, "run").items():
        found = {(row["scene"], row["shrink"], row["schedule"]): row for row in group}
        lines.append([run, *(counted(found[column]) if column in found else "" for column in columns)])
    return table(["method", *(case(those[0]) for those in columns.values())], lines)


def counted(row: dict) -> str:
    return f"{row['count']:,} ({pixels(row)}) at {perceived(row)}"


def pixels(row: dict) -> str:
    """Pixels of all training views a Gaussian."""
    share = row["pixels"] / row["count"]
    return f"{share:,.0f}" if share >= 100 else f"{share:.3g}"


def paper(rows: list[dict], charts: Path) -> str:
    """The paper's Tables 1 and 2 under both losses: Gaussians and PSNR of its methods and scenarios, and what
    SVR-GS saves."""
    lines = []
    for (*_, loss), those in by_loss(rows, ("table", "printed")).items():
        found = {row["run"]: row for row in those}
        if len(found) < 2 or PAPER not in found:
            continue
        saved = [saving(found[PAPER], found[other]) if other in found else "" for other in (RIVAL, BASE)]
        lines.append(
            [
                f"{case(those[0])}",
                loss,
                *(counted(found[run]) if run in found else "" for run in PAPER_RUNS),
                *saved,
            ]
        )
    return table(["scene", "loss", *PAPER_RUNS, f"fewer than {RIVAL}", f"fewer than {BASE}"], lines)


def table_one(rows: list[dict], charts: Path) -> str:
    """Table 1 of the paper, for each scene and loss with all steps."""
    lines = []
    whole = [row for row in rows if row["schedule"] == 1]
    for (*_, loss), those in by_loss(whole, ("table", "printed")).items():
        found = {row["run"]: row for row in those}
        for name in (run for run in TABLE_ONE if run in found):
            row = found[name]
            fewer = f"{found[BASE]['count'] / row['count']:.2f}×" if BASE in found else ""
            figures = [psnr_of(row), f"{row['ssim']:.4f}", f"{row['lpips']:.3f}", f"{row['count']:,}"]
            lines.append([case(row), loss, name, *figures, pixels(row), fewer])
    head = ["scene", "loss", "method", "PSNR", "SSIM", "LPIPS", "Gaussians", "pixels a Gaussian"]
    return table([*head, f"fewer than {BASE}"], lines)


def scenarios(rows: list[dict], charts: Path) -> str:
    """Scenarios A and B with several lambda_F, beside SVR-GS."""
    lines = []
    for those in groups(rows, "scene", "schedule", "shrink").values():
        if not any(row["study"] == "scenarios" for row in those):
            continue
        for row in those:
            if row["study"] == "scenarios" or (row["study"], row["run"]) == ("table", PAPER):
                lines.append([case(row), row["run"].replace(" 1e", ", λ_F 1e"), counted(row)])
    return table(["scene", "run", "Gaussians (pixels a Gaussian) at PSNR, LPIPS"], lines)


def by_loss(rows: list[dict], studies: Iterable[str]) -> dict[tuple, list[dict]]:
    """The rows of these studies by scene, schedule, shrink and loss."""
    found = groups(
        ({**row, "image_loss": LOSSES[row["study"]]} for row in rows if row["study"] in studies),
        "scene",
        "schedule",
        "shrink",
        "image_loss",
    )
    return {key: found[key] for key in sorted(found, key=lambda key: (-key[1], key[0], key[3] == "printed"))}


def saving(ours: dict, other: dict) -> str:
    """How many times fewer Gaussians `ours` has, and its PSNR against the other's."""
    return f"{other['count'] / ours['count']:.2f}×, {ours['psnr'] - other['psnr']:+.2f} dB"


def sweep(rows: list[dict], charts: Path) -> str:
    """The sweep of lambda_F under both losses, with a chart of count and PSNR over iterations for each."""
    lines, pictures = [], []
    sweeps = [row for row in rows if row["run"].startswith("lambda_F")]
    names = sorted({row["run"] for row in sweeps}, key=lambda run: float(run.split()[1]))
    for (scene, schedule, shrink, loss), those in by_loss(sweeps, LOSSES).items():
        found = {row["run"]: row for row in those}
        lines.append([case(those[0]), loss, *(counted(found[run]) if run in found else "" for run in names)])
        name = f"lambda-{scene}-{shrink}-{schedule:g}-{loss}"
        curve_chart(
            [(run.replace("lambda_F", "λ_F"), found[run]["curves"]) for run in names if run in found],
            case(those[0]),
            charts / f"{name}.svg",
        )
        pictures.append(f"![{case(those[0])}, {loss} loss](results/{name}.svg)\n")
    return (
        table(["scene", "loss", *(run.replace("lambda_F", "λ_F") for run in names)], lines)
        + "\n"
        + "\n".join(pictures)
    )


OF_PAGE = (
    command, equal, ablation, rivals, full_size, to_the_end, published, looks, skips, levels, in_time,
    other_figures, texture, degrees, sizes, points, table_one, paper, scenarios, sweep,
)  # fmt: skip
PARTS: dict[str, Callable[[list[dict], Path], str]] = {part.__name__: part for part in OF_PAGE}
