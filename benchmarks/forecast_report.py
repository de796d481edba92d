"""Makes docs/forecast.md from the rows of benchmarks/forecast.py: the fit, and how far the forecast was from
what runs reached."""

from __future__ import annotations

from collections.abc import Iterable
from statistics import median

from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.finetune.quality import psnr_after

HALVED = {name: method.halved for name, method in METHODS.items() if method.halved}

FITTED = ("demo", "lund")  # the scenes on which the numbers are fitted; the other two test them
PAGE = """# How near the foreseen quality comes

`benchmarks/forecast.py --show docs/forecast.md` makes this page from the rows in [results/forecast.jsonl](results/forecast.jsonl).

Estimate draws some test views twice: with all Gaussians, and with those that are expected to stay. They are those of highest
removal error (`removal`), or of largest αT (`svr`, `maskgs`). The second PSNR is that of a removal without any learning. The forecast, in mean
squared errors:

    after = now + left · (removed − now),      left = 1 / (1 + steps / H)

H is the number of steps that win back half of the error that the removal adds. It is the only fitted number, one for each method. All steps
of a run count. Code: `svrgs_addon/finetune/quality.py`.

- **Never above now.** Runs often end above the PSNR they began with, most often with `removal`: their steps train the scene further,
  and fewer Gaussians fit few photographs less closely. How much that gives differs from scene to scene and from method to method, so it is
  left out, and the panel says "or more". Most of the differences below are of this kind: the run was better than foreseen.
- **What it is good for.** Where little is lost, the forecast is "as now", and no nearer than that. Where much is removed, it tells how much
  is lost.
- **Not foreseen:** other methods; an allowed loss (`--max-drop`), which is the quality; runs of less than 800 steps. No run so short was
  measured.
- **Few photographs.** On lund and brighton (25 and 15 training views) all further steps fit the training views more closely and the test
  views less. The forecast does not know that.
- **H of `removal`.** Nearly all of its runs below ended above the PSNR of now, so they fix no H. 10 is that of pruning demo to 5 % (8 000 steps: 9.9;
  3 200: 18; 800: 12).
- **Only measured at 15 to 30 dB.**

A difference is forecast minus run, in dB: plus means that the run was worse than foreseen. What is compared is the change from the PSNR
before the run. Medians are those of absolute values. "As now" is the forecast that nothing changes, for comparison.

## Fit and test

H is fitted on {fitted} and tested on the other two scenes: pruning to 50, 25, 17 and 8 % with three tenths of the steps (2 400), as in
[results.md](results.md#rivals-as-they-are-on-a-capture-that-was-left-out). The runs (means over their seeds) were made with an earlier version.
Their splats were trained again for the forecast, with the same command, which gives nearly the same splat.

{fit}
## Light, Balanced and Small

The goals of the panel, with the default method. Forecast and run have the same file. The scenes were trained for 3 000 steps
(`svrgs train --schedule 0.1`), with photographs of a half, snowmiku of a quarter.

{strengths}
## Other numbers of steps

{steps}
## Every run of the fit and the test

Changes of PSNR in dB, foreseen and reached.

{targets}"""  # noqa: E501


def page(rows: list[dict]) -> str:
    """The page as Markdown."""
    parts = {kind: [row for row in rows if row["kind"] == kind] for kind in ("targets", "strengths", "steps")}
    return PAGE.format(
        fitted=" and ".join(FITTED), fit=fit_table(parts["targets"]),
        strengths=run_table(parts["strengths"]), steps=run_table(parts["steps"]),
        targets=target_table(parts["targets"]),
    )  # fmt: skip


def change(row: dict, halved: float) -> float:
    """The foreseen change of PSNR in dB, by the law with this number."""
    found = row["foreseen"]
    return (
        psnr_after(found["psnr_before"], found["psnr_removed"], row["steps"], halved) - found["psnr_before"]
    )


def difference(row: dict, halved: float | None = None) -> float:
    """Foreseen minus reached change of PSNR in dB."""
    return change(row, halved or HALVED[row["method"]]) - reached(row)


def reached(row: dict) -> float:
    """The change of PSNR in dB that the run reached."""
    return row["measured"]["after"] - row["measured"]["before"]


def as_now(row: dict) -> float:
    """The difference of the forecast that nothing changes."""
    return -reached(row)


def fit(rows: list[dict]) -> float:
    """The number H with the least sum of absolute differences."""
    return min(
        (10 ** (k / 100) for k in range(250)),
        key=lambda halved: sum(abs(difference(row, halved)) for row in rows),
    )


def fit_table(rows: list[dict]) -> str:
    lines = []
    for method in HALVED:
        own = [row for row in rows if row["method"] == method]
        fitted = fit([row for row in own if row["scene"] in FITTED])
        for on in ("fit", "test"):
            part = [row for row in own if (row["scene"] in FITTED) == (on == "fit")]
            scenes = " and ".join(dict.fromkeys(row["scene"] for row in part))
            figures = [
                text for values in (map(difference, part), map(as_now, part)) for text in spread_of(values)
            ]
            lines.append(
                [
                    f"`{method}`",
                    f"{HALVED[method]:g} ({fitted:.1f})",
                    f"{on}: {scenes}",
                    str(len(part)),
                    *figures,
                ]
            )
    return table(
        [
            "method",
            "H in use (fitted)",
            "scenes",
            "counts",
            "median",
            "least to largest",
            '"as now": median',
            "least to largest",
        ],
        lines,
    )


def spread_of(values: Iterable[float]) -> tuple[str, str]:
    """Median of the absolute values; least and largest value."""
    values = list(values)
    return f"{median(map(abs, values)):.2f}", f"{min(values):+.2f} to {max(values):+.2f}"


def run_table(rows: list[dict]) -> str:
    lines = []
    for row in rows:
        found, measured = row["foreseen"], row["measured"]
        after = psnr_after(found["psnr_before"], found["psnr_removed"], row["steps"], HALVED[row["method"]])
        counts = [f"{found['count']:,}", f"{found['kept']:,}", f"{measured['count']:,.0f}"]
        figures = [found["psnr_before"], found["psnr_removed"], after, measured["after"]]
        lines.append(
            [
                row["scene"],
                row["run"],
                f"{row['steps']:,}",
                *counts,
                *(f"{value:.2f}" for value in figures),
                f"{difference(row):+.2f}",
            ]
        )
    if not lines:
        return "Not measured yet with the methods of today.\n"
    said = [
        f"median {middle} dB, {both} dB"
        for middle, both in (spread_of(map(difference, rows)), spread_of(map(as_now, rows)))
    ]
    text = f'Difference: {said[0]}. Of the forecast "as now": {said[1]}.\n\n'
    head = [
        "scene",
        "run",
        "steps",
        "Gaussians",
        "foreseen to stay",
        "stayed",
        "PSNR now",
        "removed only",
        "foreseen",
        "reached",
        "difference",
    ]
    return text + table(head, lines)


def target_table(rows: list[dict]) -> str:
    places = {(row["scene"], row["run"].split()[1]): None for row in rows}
    found = {(row["scene"], row["run"].split()[1], row["method"]): row for row in rows}
    lines = []
    for scene, target in places:
        cells = [found.get((scene, target, method)) for method in HALVED]
        texts = [
            f"{change(row, HALVED[row['method']]):+.2f}, {reached(row):+.2f}" if row else "" for row in cells
        ]
        lines.append([scene, f"{float(target):.0%}", *texts])
    return table(["scene", "Gaussians", *(f"`{method}`" for method in HALVED)], lines)


def table(head: list[str], lines: list[list[str]]) -> str:
    rows = [head, ["---"] * len(head), *lines]
    return "".join(f"| {' | '.join(cells)} |\n" for cells in rows)
