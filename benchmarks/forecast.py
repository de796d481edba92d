"""How near the quality that Estimate foresees comes to what runs reach: adds rows to
docs/results/forecast.jsonl, or makes docs/forecast.md of them.

    .venv/bin/python benchmarks/forecast.py --scene demo=DIR --scene lund=DIR ... [--shrink 2]
                                                       # first: benchmarks/methods.py --study pareto
    .venv/bin/python benchmarks/forecast.py --scene demo=DIR --trained FILE.ply --only strengths
    .venv/bin/python benchmarks/forecast.py --show docs/forecast.md   # from the rows; runs nothing

    targets    the methods of METHODS at the counts of benchmarks/methods.py --study pareto; what the runs
               reached is taken from its rows
    strengths  the default method with lambda_F as the goals Light, Balanced and Small
    steps      the default method and `svr` at one count with several --schedule

A scene is trained as the row 3DGS of benchmarks/methods.py with a tenth of the schedule, if --work does not
hold it; --trained names another file. Runs of strengths and steps are kept as --work/NAME/RUN.json. Estimate
may take its time here, so that a busy machine does not change its figures.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from statistics import fmean

from cost import svrgs
from forecast_report import page
from method_scenes import prepared
from method_studies import TABLE, TARGETS
from methods import ROOT, command, read_rows, start_file

METHODS = ("removal", "svr", "maskgs")
SCHEDULE = 0.3  # of the rows of study pareto, and of the runs here where it is not varied
# lambda_F of the goals of the panel (operators/jobs/goals.py)
STRENGTHS = {"Light": 1e-5, "Balanced": 1e-4, "Small": 1e-3}
STEPS = {"removal": ("0.08", (0.1, 0.3, 1.0)), "svr": ("0.17", (0.1, 1.0))}
ESTIMATE = """
import sys
from svrgs_addon.system.exit_status import answer
from svrgs_addon.jobs import estimate
from svrgs_addon.prune import expected_count, quality_forecast
expected_count.VIEW_SECONDS = quality_forecast.SECONDS = 600
sys.exit(answer(estimate._estimate_request))
"""


def cases(options: argparse.Namespace) -> Iterator[tuple]:
    """(kind, label, method, options of the job, schedule) of each row of a scene."""
    if "targets" in options.only:
        for method in METHODS:
            for target in TARGETS:
                yield "targets", f"{method} {target}", method, {"target": float(target)}, SCHEDULE
    if "strengths" in options.only:
        for label, value in STRENGTHS.items():
            yield "strengths", label, "removal", {"lambda_f": value}, options.schedule
    if "steps" in options.only:
        for method, (target, schedules) in STEPS.items():
            for schedule in schedules:
                yield "steps", f"{method} {target} {schedule:g}", method, {"target": float(target)}, schedule


def row(options: argparse.Namespace, name: str, data: list[str], trained: Path, case: tuple) -> dict | None:
    """The row of a case; None if no run is known and none is made (targets)."""
    kind, label, method, words, schedule = case
    if kind == "targets":
        measured = published(name, label, schedule)
    else:
        measured = reached(
            trained, data, options.work.resolve() / name / f"{label}.json", method, words, schedule
        )
    if measured is None:
        return None
    found = foreseen(
        trained,
        data,
        {
            "method": method,
            **words,
            "iterations": round(3_000 * schedule),
            "recovery": round(5_000 * schedule),
        },
    )
    keys = ("count", "kept", "psnr_before", "psnr_removed", "psnr_after")
    steps = round(8_000 * schedule)
    return {
        "kind": kind,
        "scene": name,
        "run": label,
        "method": method,
        "steps": steps,
        "foreseen": {key: found[key] for key in keys},
        "measured": measured,
    }


def published(name: str, label: str, schedule: float) -> dict | None:
    """Means over the seeds of the rows of study pareto."""
    rows = [
        r
        for r in read_rows(ROOT / "docs/results/rows.jsonl")
        if (r["study"], r["scene"], r["run"], r["schedule"]) == ("pareto", name, label, schedule)
    ]
    return outcome(rows) if rows else None


def outcome(rows: list[dict]) -> dict:
    means = {
        "count": [r["count"] for r in rows],
        "before": [r["before"]["psnr"] for r in rows],
        "after": [r["psnr"] for r in rows],
    }
    return {"runs": len(rows), **{key: fmean(values) for key, values in means.items()}}


def reached(trained: Path, data: list[str], kept: Path, method: str, words: dict, schedule: float) -> dict:
    """The outcome of a run of `svrgs prune`, or of the same run before."""
    if not kept.exists():
        flags = [word for key, value in words.items() for word in (f"--{key.replace('_', '-')}", value)]
        out = ["--out", kept.with_suffix(".ply"), "--schedule", schedule, "--quiet"]
        kept.write_text(json.dumps(svrgs("prune", trained, *out, "--method", method, *flags, *data)))
    return outcome([json.loads(kept.read_text())])


def foreseen(trained: Path, data: list[str], words: dict) -> dict:
    """The estimate of a job with these options."""
    places = dict(zip(("data", "images"), data[1::2], strict=False))
    return json.loads(
        run(
            [sys.executable, "-c", ESTIMATE],
            json.dumps({"scene": str(trained), "options": {**words, **places}}),
        )
    )


def run(call: list, text: str | None = None) -> str:
    """What a command prints. It ends the program if the command fails."""
    done = subprocess.run([str(word) for word in call], cwd=ROOT, input=text, capture_output=True, text=True)
    if done.returncode:
        sys.exit(f"{call[:6]}: {(done.stderr or done.stdout).strip().splitlines()[-1]}")
    return done.stdout


def add_rows(options: argparse.Namespace):
    done = {(r["kind"], r["scene"], r["run"]) for r in read_rows(options.rows)}
    for given in options.scene:
        name, _, folder = given.partition("=")
        work = options.work / name
        data = prepared(name, Path(folder).resolve() if folder else None, work.resolve(), options.shrink)
        request = {
            "study": "table", "scene": name, "run": "3DGS", "flags": TABLE["3DGS"], "seed": 0,
            "schedule": 0.1, "trained": 0.1, "start": "3DGS", "shrink": options.shrink,
        }  # fmt: skip
        trained = (options.trained or start_file(request, work)).resolve()
        if not trained.exists():
            if options.trained:
                sys.exit(f"{options.trained}: does not exist")
            run(command(request, data, work.resolve(), 0))
        for case in cases(options):
            if (case[0], name, case[1]) in done or (found := row(options, name, data, trained, case)) is None:
                continue
            with options.rows.open("a") as file:
                file.write(json.dumps(found) + "\n")
            figures = found["foreseen"], found["measured"]
            print(
                f"{name}, {case[1]}: foreseen {figures[0]['psnr_after']:.2f} dB, reached"
                f" {figures[1]['after']:.2f} dB",
                flush=True,
            )


def main():
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument(
        "--scene", action="append", default=[], metavar="NAME=DIR", help="name and folder of a COLMAP dataset"
    )
    parser.add_argument(
        "--shrink", type=int, default=1, help="reduction of the photographs per side (default: 1)"
    )
    parser.add_argument("--trained", type=Path, metavar="FILE", help="the trained splat of the scene")
    parser.add_argument(
        "--schedule", type=float, default=SCHEDULE, help="--schedule of the runs of strengths (default: 0.3)"
    )
    parser.add_argument(
        "--only", action="append", choices=("targets", "strengths", "steps"), help="default: all"
    )
    parser.add_argument("--rows", type=Path, default=ROOT / "docs" / "results" / "forecast.jsonl")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "methods")
    parser.add_argument(
        "--show", type=Path, metavar="FILE", help="write the page to this file, and run nothing"
    )
    options = parser.parse_args()
    options.only = options.only or ["targets", "strengths", "steps"]
    if options.show:
        options.show.write_text(page(read_rows(options.rows)))
    else:
        add_rows(options)


if __name__ == "__main__":
    main()
