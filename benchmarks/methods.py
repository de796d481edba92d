"""Every method in the same trainer: scenes x methods x seeds, one row of figures per run.

    .venv/bin/python benchmarks/methods.py --scene NAME=DIR ... [--study NAME ...] [--schedule 0.1] [--shrink
    2] [--seeds 1]
    .venv/bin/python benchmarks/methods.py --scene demo=build/demo/scene            # a folder that exists
    .venv/bin/python benchmarks/methods.py --scene demo --scene room --scene portrait --scene row
                                                       # the generated scenes, made if missing
    .venv/bin/python benchmarks/methods.py --page --rows build/rows.jsonl --scene snowmiku=DIR
                                                       # all runs of docs/results.md anew
    .venv/bin/python benchmarks/methods.py --show docs
                                                       # writes docs/results.md and its charts from the rows

Rows are added to --rows (default docs/results/rows.jsonl), one JSON object per line. A run whose row exists
is not run again, and a run that was stopped goes on from its last checkpoint, so an experiment can be stopped
and continued; how long the rest takes is foreseen from the rows. --work (default build/methods) holds the
scenes that later runs need; those that are missing are trained first. --jobs 8 has that many runs at a time.
--part 1/3, 2/3, 3/3 divide the runs among three machines, in any order; --join FILE adds the rows of another
machine.

    table     `svrgs train` with each method from sparse points, all with the published schedule times
              --schedule
    lambda    the sweep of lambda_F of the paper, from sparse points
    printed   the runs of the paper's tables and its sweep, with the weights of the image loss that it prints:
              L1 + (1 - SSIM)
    pareto    `svrgs prune` of the scene of `table` that --start names (trained with the schedule --trained),
              every method at several counts; `removal` with the rates of 3DGS; MCMC trained straight there
    ablation  the same with method `removal`, with one part of it changed at a time
    equal     the same with the recipe of `removal` (lowering, rates, averaging) and the rankings of other
              methods, and with nothing removed: what the ranking is worth, and what the recipe
    published rivals with their published steps, `removal` with as many; to be run with --schedule 1
    degrees   `removal` to SPZ files with fewer SH bands: at the same share, and at about the same size
    sizes     the same to SPZ files of one size
    skips     `svrgs train` with what skips work: smaller photographs at first, fewer of the easiest views
    levels    `svrgs train` with each SIMD level
    scenarios `svrgs train` with scenarios A and B of the paper and several lambda_F
    looks     the same with less exact looks at what stays (benchmarks/looks.py)
    time      the same to 10 %, where each method has the same seconds (`--time`); to be run on a quiet
              machine. --only 10 runs one limit
"""

from __future__ import annotations

import argparse
import hashlib
import json
import math
import os
import shutil
import statistics
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor, as_completed
from functools import cache
from pathlib import Path

from cost import svrgs
from method_report import write_report
from method_scenes import GENERATED, prepared
from method_studies import PRUNED, STARTS, STUDIES, TABLE, change_of
from svrgs_addon.files.registry import read_scene
from svrgs_addon.render.metrics.lpips import weights_file
from svrgs_addon.views.dataset import load_dataset

ROOT = Path(__file__).resolve().parents[1]
ROWS = ROOT / "docs" / "results" / "rows.jsonl"
KEPT = (
    "psnr ssim lpips flip count bytes seconds ms_per_frame iterations before curves peak_memory_bytes time"
).split()
REQUEST = ("study", "scene", "run", "flags", "seed", "schedule", "trained", "start", "shrink")


def requests(options: argparse.Namespace) -> Iterator[dict]:
    """The keys that identify each run, scene by scene, so that a stopped experiment has complete scenes."""
    if options.page:
        given = {*GENERATED, *(scene.partition("=")[0] for scene in options.scene)}
        page = [{name: row[name] for name in REQUEST} for row in read_rows(ROWS)]
        yield from (request for request in page if request["scene"] in given)
        for scene in sorted({request["scene"] for request in page} - given):
            print(f"{scene} is left out: it has no folder, give --scene {scene}=DIR")
        return
    for scene in options.scene:
        for seed in range(options.seeds):
            for study in options.study:
                for label, flags in STUDIES[study].items():
                    if options.only and not any(
                        word == label or word in label.split() for word in options.only
                    ):
                        continue
                    yield {
                        "study": study, "scene": scene.partition("=")[0], "run": label, "flags": flags,
                        "seed": seed,
                        "schedule": 1.0 if study == "time" else options.schedule,
                        "trained": options.trained or options.schedule,
                        "start": options.start, "shrink": options.shrink,
                    }  # fmt: skip


def start_of(request: dict) -> dict:
    """The run of `table` whose scene a run of PRUNED prunes."""
    run, trained = request["start"], request["trained"]
    return {**request, "study": "table", "run": run, "flags": TABLE[run], "schedule": trained}


def is_start(request: dict) -> bool:
    """Whether other runs prune the scene of this one."""
    return request["study"] == "table" and request["run"] in STARTS


def start_file(request: dict, work: Path) -> Path:
    """The scene of such a run."""
    return work / f"{request['run']}-{request['seed']}-{request['schedule']}-{request['shrink']}.ply"


def command(request: dict, data: list[str], work: Path, threads: int) -> list[str]:
    """The svrgs command of a run. data: its flags --data and --images."""
    suffix = ".spz" if request["study"] in ("degrees", "sizes") else ".ply"
    own = work / f"{hashlib.sha256(key(request).encode()).hexdigest()[:16]}{suffix}"
    out = start_file(request, work) if is_start(request) else own
    schedule = [] if request["study"] == "time" else ["--schedule", str(request["schedule"])]
    # a limit of time counts the seconds of LPIPS, too: measured afterwards
    weights = [] if request["study"] == "time" else lpips_weights()
    common = ["--out", str(out), *request["flags"], *data, "--seed", str(request["seed"]), *schedule]
    common += ["--exposure", "off", "--refine-poses", "off"]  # so that all have the same photographs
    common += [*weights, "--threads", str(threads), "--json", "--quiet"]
    change = change_of(request["study"], request["run"])
    program = [
        sys.executable,
        "-c",
        f"import sys; {change or 'pass'}\nfrom svrgs_addon.cli.main import main\nsys.exit(main())",
    ]
    if request["study"] in PRUNED:
        start = start_file(start_of(request), work)
        if request["run"].startswith("mcmc "):
            cap = round(float(request["run"].rpartition(" ")[2]) * read_scene(start).count)
            return [*program, "train", *common, "--cap", str(cap)]
        return [*program, "prune", str(start), *common]
    return [*program, "train", *common]


def measured(request: dict, data: list[str], work: Path, threads: int = 0) -> dict:
    """The row of a run: its request and its figures, or an error."""
    started = time.time()
    if request["study"] in PRUNED and not start_file(start_of(request), work).exists():
        return {**request, "error": "the scene to prune is missing, as its training failed"}
    words = command(request, data, work, threads)
    out = Path(words[words.index("--out") + 1])
    if Path(f"{out}.job").exists():  # of a run that was stopped
        words.append("--resume")
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return {**request, "error": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    result = json.loads(done.stdout)
    if request["study"] == "time":
        result |= evaluated(out, data)
    if not is_start(request):
        out.unlink()
        shutil.rmtree(f"{out}.job", ignore_errors=True)
    return {
        **request,
        "wall_seconds": max(time.time() - started, result["seconds"]),  # it may have been resumed
        "pixels": training_pixels(tuple(data)),
        **{key: result[key] for key in KEPT if key in result},
    }


def lpips_weights() -> list[str]:
    """The flag that names the weights of LPIPS; nothing where they are not there."""
    file = weights_file()
    return ["--lpips-weights", str(file)] if file.is_file() else []


def evaluated(scene: Path, data: list[str]) -> dict:
    """The figures of a file on the test views."""
    figures = svrgs("eval", scene, *data, *lpips_weights())
    return {name: figures[name] for name in ("psnr", "ssim", "lpips", "flip") if name in figures}


@cache
def training_pixels(data: tuple[str, ...]) -> int:
    """Of all training views. data: the flags --data and --images."""
    dataset = load_dataset(*data[1::2])
    return sum(dataset.cameras[i].width * dataset.cameras[i].height for i in dataset.train_indices)


def key(row: dict) -> str:
    return json.dumps([row[name] for name in REQUEST])


def read_rows(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def run(options: argparse.Namespace):
    rows = read_rows(options.rows)
    done = {key(row) for row in rows if "error" not in row}
    part, _, parts = options.part.partition("/")
    mine = list(requests(options))[int(part) - 1 :: int(parts)]
    wanted = [request for request in mine if key(request) not in done]
    options.rows.parent.mkdir(parents=True, exist_ok=True)
    data = {
        place: prepared(place[0], folder_of(options, place[0]), options.work / place[0], place[1])
        for place in {(request["scene"], request["shrink"]) for request in wanted}
    }
    starts = [start_of(request) for request in wanted if request["study"] in PRUNED]
    # those whose scene is missing, and those whose row is
    missing = {key(one): one for one in starts if not start_file(one, options.work / one["scene"]).exists()}
    missing |= {key(one): one for one in wanted if is_start(one)}
    first, rest = list(missing.values()), [one for one in wanted if key(one) not in missing]
    threads = 0 if options.jobs == 1 else max(1, (os.cpu_count() or 1) // options.jobs)  # 0: one per core

    def row_of(request: dict) -> dict:
        place = request["scene"], request["shrink"]
        return measured(request, data[place], options.work / request["scene"], threads)

    times = rows if options.rows == ROWS else rows + read_rows(ROWS)
    print(f"{len(first) + len(rest)} runs; {foreseen(times, first + rest, options.jobs)}", flush=True)
    left = {key(one): one for one in (*first, *rest)}
    with ThreadPoolExecutor(options.jobs) as pool:
        for some in (first, rest):
            for row in (ended.result() for ended in as_completed([pool.submit(row_of, one) for one in some])):
                del left[key(row)]
                times.append(row)
                if key(row) not in done:  # a scene may be missing whose row is there
                    with options.rows.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                after = foreseen(times, list(left.values()), options.jobs)
                print(f"{sentence(row)}; {after}", flush=True)


def join(rows: Path, others: list[Path]):
    """Adds the rows of other files that are not there."""
    done = {key(row) for row in read_rows(rows) if "error" not in row}
    new = {key(row): row for path in others for row in read_rows(path) if "error" not in row}
    with rows.open("a") as file:
        file.writelines(json.dumps(row) + "\n" for name, row in new.items() if name not in done)


def sentence(row: dict) -> str:
    """Of a run that has ended."""
    figures = (
        row.get("error") or f"{row['count']:,} Gaussians, {row['psnr']:.2f} dB, {row['wall_seconds']:.0f} s"
    )
    return f"{row['scene']}, {row['study']}, {row['run']}, seed {row['seed']}: {figures}"


def foreseen(rows: list[dict], wanted: list[dict], jobs: int) -> str:
    """How long runs take, foreseen from rows of the same scene, size and length; of other lengths if there
    are none."""

    def seconds(request: dict) -> float:
        alike = [
            (row["wall_seconds"] * request["schedule"] / row["schedule"], row)
            for row in rows
            if "error" not in row and all(row[name] == request[name] for name in ("scene", "shrink"))
        ]
        near = [
            took for took, row in alike if all(row[name] == request[name] for name in ("study", "schedule"))
        ]
        known = near or [took for took, _ in alike]
        return statistics.median(known) if known else math.nan

    total = sum(map(seconds, wanted)) / jobs
    return (
        f"about {total / 60:.0f} min left" if math.isfinite(total) else "how long they take is not known yet"
    )


def folder_of(options: argparse.Namespace, scene: str) -> Path | None:
    """The folder of a scene's dataset; None for a generated scene, unless a folder is given."""
    return next(
        (
            Path(folder)
            for name, _, folder in (given.partition("=") for given in options.scene)
            if name == scene and folder
        ),
        None,
    )


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    add = parser.add_argument
    generated = f"without a folder: a generated scene ({', '.join(GENERATED)})"
    folders = f"name and folder of a COLMAP dataset; {generated}"
    add("--scene", action="append", default=[], metavar="NAME=DIR", help=folders)
    add("--study", action="append", choices=list(STUDIES), help="default: all")
    only = "only runs of this name, or with this word in it"
    add("--only", action="append", metavar="WORD", help=only)
    schedule = "share of the published 30 000 + 5 000 iterations (default: 0.1)"
    add("--schedule", type=float, default=0.1, help=schedule)
    trained = f"with {', '.join(PRUNED)}: the schedule of the scene that is pruned (default: --schedule)"
    add("--trained", type=float, help=trained)
    start = "with these studies: the run of `table` whose scene is pruned (default: 3DGS)"
    add("--start", choices=STARTS, default="3DGS", help=start)
    add("--shrink", type=int, default=1, help="reduction of the photographs per side (default: 1)")
    add("--seeds", type=int, default=1)
    add("--jobs", type=int, default=1, help="runs at a time (default: 1)")
    add("--part", default="1/1", metavar="K/N", help="every N-th run alone, from the K-th")
    joined = "add the rows of this file, and run nothing"
    add("--join", type=Path, action="append", metavar="FILE", help=joined)
    add("--rows", type=Path, default=ROWS)
    page = "all runs that docs/results.md shows, made anew in --rows, but for scenes without a folder"
    add("--page", action="store_true", help=page)
    add("--work", type=Path, default=ROOT / "build" / "methods")
    show = "write results.md and results/*.svg to this folder, and run nothing"
    add("--show", type=Path, metavar="DIR", help=show)
    options = parser.parse_args()
    if options.page and options.rows == ROWS:
        parser.error("--page needs --rows FILE, another file than that of the page")
    options.study = options.study or list(STUDIES)
    return options


def main():
    options = parsed()
    if options.show:
        write_report(read_rows(options.rows), options.show)
    elif options.join:
        join(options.rows, options.join)
    else:
        run(options)


if __name__ == "__main__":
    main()
