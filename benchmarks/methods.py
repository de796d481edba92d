"""Every method in the same trainer: scenes x methods x seeds, one row of figures per run.

    .venv/bin/python benchmarks/methods.py --scene NAME=DIR ... [--study NAME ...] [--schedule 0.1] [--shrink
    2] [--seeds 1]
    .venv/bin/python benchmarks/methods.py --scene demo=build/demo/scene            # a folder that exists
    .venv/bin/python benchmarks/methods.py --scene demo --scene room --scene portrait --scene row
                                                       # the generated scenes, made if missing
    .venv/bin/python benchmarks/methods.py --show docs
                                                       # writes docs/results.md and its charts from the rows

Rows are added to --rows (default docs/results/rows.jsonl), one JSON object per line. A run whose row exists
is not run again, so a stopped experiment can be continued, and how long the rest takes is foreseen from the
rows. --work (default build/methods) holds the scenes that later runs need; those that are missing are trained
first. --jobs 8 has that many runs at a time. --part 1/3, 2/3, 3/3 divide the runs among three machines, in
any order; --join FILE adds the rows of another machine.

    table     `svrgs train` with each method from sparse points, all with the published schedule times
              --schedule
    lambda    the sweep of lambda_F of the paper, from sparse points
    printed   the runs of the paper's tables and its sweep, with the weights of the image loss that it prints:
              L1 + (1 - SSIM)
    pareto    `svrgs prune` of the scene of `table` that --start names (trained with the schedule --trained),
              every method at several counts
    ablation  the same with method `removal`, with one part of it changed at a time
    equal     the same with the recipe of `removal` (lowering, rates, averaging) and the rankings of other
              methods, and with nothing removed: what the ranking is worth, and what the recipe; and MCMC
              trained straight to the number
    looks     the same with less exact looks at what stays (benchmarks/looks.py)
    schedules the same with the default and its nearest rivals, down to 2 %; to be run with several --schedule
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

from looks import LOOKS
from method_report import write_report
from method_scenes import GENERATED, prepared
from svrgs_addon.files.registry import read_scene
from svrgs_addon.finetune.methods import METHODS
from svrgs_addon.render.metrics.lpips import weights_file
from svrgs_addon.views.dataset import load_dataset

ROOT = Path(__file__).resolve().parents[1]
KEPT = (
    "psnr",
    "ssim",
    "lpips",
    "flip",
    "count",
    "bytes",
    "seconds",
    "ms_per_frame",
    "iterations",
    "before",
    "curves",
    "peak_memory_bytes",
    "time",
)
ITERATIONS, RECOVERY = 30_000, 5_000

TABLE = {
    "3DGS": ["--method", "3dgs", "--recovery", str(RECOVERY)],
    "MCMC": ["--method", "3dgs", "--recovery", str(RECOVERY), "--densify", "mcmc", "--cap", "100000"],
    "LightGaussian": ["--method", "lightgaussian"],
    "Compact3DGS": ["--method", "compact3dgs"],
    "MaskGS alpha": ["--method", "maskgs-alpha"],
    "MaskGS beta": ["--method", "maskgs-beta"],
    "MaskGS gamma": ["--method", "maskgs-gamma"],
    "GNS pressure": ["--method", "gns"],
    "SVR-GS": ["--method", "svr"],
    "Scenario A": ["--method", "svr-a"],
    "Scenario B": ["--method", "svr-b"],
    "SVR-GS, self term": ["--method", "svr-self"],
    "SVR-GS, even": ["--method", "svr-even"],
    "removal": ["--method", "removal"],
}
STARTS = ("3DGS", "MCMC")  # runs of `table` whose scenes are pruned
PAPER = ("3DGS", "MaskGS alpha", "SVR-GS", "Scenario A", "Scenario B")  # the runs of its tables
SWEEP = {
    f"lambda_F {value}": ["--method", "svr", "--lambda-f", value]
    for value in ("1e-4", "1.25e-4", "1.6e-4", "2e-4")
}
PRINTED = (
    "from svrgs_addon.finetune.methods import METHODS; [setattr(m, 'image_weights', (1.0, 1.0)) for m in"
    " METHODS.values()]"
)
DEEP = ("0.25", "0.1", "0.05", "0.02")
TARGETS = ("0.5", "0.25", "0.1", "0.05")
RIVALS = (
    "opacity", "contribution", "max-contribution", "pup", "lightgaussian", "compact3dgs", "maskgs", "gns",
    "gaussianpop", "popspa", "speedy", "minisplatting", "reduced3dgs", "efficientgs", "rdo",
)  # fmt: skip
LIMITS = (10, 30, 60, 120)  # seconds
IN_TIME = ("removal", "maskgs", "gns", "speedy")
OURS = ("svr", "svr-self", "svr-even", "saliency", "removal")
# for methods that only recover: 3 000 + 5 000, as many steps as the others
AS_MANY_STEPS = ["--recovery", "8000"]


def pareto() -> dict[str, list[str]]:
    """The runs of the study pareto: every method at every target."""
    runs = {"3dgs": ["--method", "3dgs", *AS_MANY_STEPS]}
    for method in RIVALS + OURS:
        steps = AS_MANY_STEPS if METHODS[method].ranks else []
        runs |= {f"{method} {target}": ["--method", method, "--target", target, *steps] for target in TARGETS}
    return runs


REMOVAL = "from svrgs_addon.finetune.methods import removal; "
ABLATION = {  # name of the run: Python code that changes the program before it runs
    "removal": "",
    "opacities not lowered": REMOVAL + "removal.lowering = lambda steps: (1.0, 1.0)",
    "odds of opacities not lowered": REMOVAL + "removal.MIN_ODDS_FACTOR = 1.0",
    "opacity rate the same in the whole phase": REMOVAL + "removal.FIRST_RATE = 1",
    "values not averaged": REMOVAL + "removal.AVERAGED = 0.0",
    "position rate of 3DGS at the end": REMOVAL + "removal.POSITION_LAST = 1.6e-6",
    "8 passes": REMOVAL + "removal.PASSES = 8",
    "opacity rate of the other methods": REMOVAL + "removal.OPACITY_RATE = 0.05",
}
RANKED = "from svrgs_addon.finetune.methods import METHODS; METHODS['removal'].ranking = "
RANKINGS = {"removal": ""} | {
    name: f"{RANKED}METHODS['{name}'].score"
    for name in ("speedy", "lightgaussian", "contribution", "opacity")  # that of removal is GaussianPOP's
}
RANKINGS["random"] = (
    f"import numpy; {RANKED}lambda scene, *_: numpy.random.default_rng(scene.count).random(scene.count)"
)
LOOKING = {name: f"from looks import look; {RANKED}look({name!r})" for name in LOOKS if not LOOKS[name][2]}
EQUAL_TARGETS = ("0.5", "0.25", "0.1", "0.05", "0.025")


def equal() -> dict[str, list[str]]:
    """The runs of the study equal. Nothing removed: what the steps alone give, plain and by the recipe."""
    runs = {
        "steps of 3dgs 1": ["--method", "3dgs", *AS_MANY_STEPS],
        "removal 1": ["--method", "removal", "--target", "1"],
    }
    straight = ["--method", "3dgs", "--recovery", str(RECOVERY + 8000), "--densify", "mcmc"]
    runs |= {f"mcmc {target}": straight for target in EQUAL_TARGETS}
    for target in EQUAL_TARGETS:
        runs |= {f"{name} {target}": ["--method", "removal", "--target", target] for name in RANKINGS}
    return runs


STUDIES = {
    "table": TABLE,
    "equal": equal(),
    "looks": {
        f"{name} {target}": ["--method", "removal", "--target", target]
        for target in ("0.25", "0.1")
        for name in LOOKING
    },
    "printed": {run: TABLE[run] for run in PAPER} | SWEEP,
    "lambda": SWEEP,
    "pareto": pareto(),
    "ablation": {
        f"{label} {target}": ["--method", "removal", "--target", target]
        for target in ("0.17", "0.05")
        for label in ABLATION
    },
    "schedules": {
        f"{method} {target}": ["--method", method, "--target", target]
        for target in DEEP
        for method in ("removal", "maskgs", "gns")
    },
    "time": {
        f"{method} {limit} s": ["--method", method, "--target", "0.1", "--time", str(limit)]
        for limit in LIMITS
        for method in IN_TIME
    },
}
PRUNED = (
    "equal",
    "looks",
    "pareto",
    "ablation",
    "schedules",
    "time",
)  # studies that prune the 3DGS scene of `table`


def requests(options: argparse.Namespace) -> Iterator[dict]:
    """The keys that identify each run, scene by scene, so that a stopped experiment has complete scenes."""
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
    own = work / f"{hashlib.sha256(key(request).encode()).hexdigest()[:16]}.ply"
    out = start_file(request, work) if is_start(request) else own
    schedule = [] if request["study"] == "time" else ["--schedule", str(request["schedule"])]
    file = weights_file()  # of LPIPS, which takes seconds that a limit of time counts
    weights = ["--lpips-weights", str(file)] if file.is_file() and request["study"] != "time" else []
    common = ["--out", str(out), *request["flags"], *data, "--seed", str(request["seed"]), *schedule]
    common += [*weights, "--threads", str(threads), "--json", "--quiet"]
    label = request["run"].rpartition(" ")[0]
    changes = {
        "ablation": ABLATION.get(label),
        "equal": RANKINGS.get(label),
        "looks": LOOKING.get(label),
        "printed": PRINTED,
    }
    change = changes.get(request["study"])
    program = [
        sys.executable,
        "-c",
        f"import sys; {change or 'pass'}\nfrom svrgs_addon.cli.main import main\nsys.exit(main())",
    ]
    if request["study"] in PRUNED:
        start = start_file(start_of(request), work)
        if label == "mcmc":
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
    done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True)
    if done.returncode:
        return {**request, "error": (done.stderr.strip().splitlines() or ["no message"])[-1]}
    if not is_start(request):
        out = Path(words[words.index("--out") + 1])
        out.unlink()
        shutil.rmtree(f"{out}.job", ignore_errors=True)
    result = json.loads(done.stdout)
    return {
        **request,
        "wall_seconds": time.time() - started,
        "pixels": training_pixels(tuple(data)),
        **{key: result[key] for key in KEPT if key in result},
    }


@cache
def training_pixels(data: tuple[str, ...]) -> int:
    """Of all training views. data: the flags --data and --images."""
    dataset = load_dataset(*data[1::2])
    return sum(dataset.cameras[i].width * dataset.cameras[i].height for i in dataset.train_indices)


def key(row: dict) -> str:
    return json.dumps(
        [
            row[name]
            for name in ("study", "scene", "run", "flags", "seed", "schedule", "trained", "start", "shrink")
        ]
    )


def read_rows(path: Path) -> list[dict]:
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def run(options: argparse.Namespace):
    rows = read_rows(options.rows)
    done = {key(row) for row in rows if "error" not in row}
    part, _, parts = options.part.partition("/")
    mine = list(requests(options))[int(part) - 1 :: int(parts)]
    wanted = [request for request in mine if key(request) not in done]
    options.rows.parent.mkdir(parents=True, exist_ok=True)
    works = {request["scene"]: options.work / request["scene"] for request in wanted}
    datas = {
        scene: prepared(scene, folder_of(options, scene), work, options.shrink)
        for scene, work in works.items()
    }
    starts = [start_of(request) for request in wanted if request["study"] in PRUNED]
    # those whose scene is missing, and those whose row is
    missing = {key(one): one for one in starts if not start_file(one, works[one["scene"]]).exists()}
    missing |= {key(one): one for one in wanted if is_start(one)}
    first, rest = list(missing.values()), [one for one in wanted if key(one) not in missing]
    threads = 0 if options.jobs == 1 else max(1, (os.cpu_count() or 1) // options.jobs)  # 0: one per core

    def row_of(request: dict) -> dict:
        scene = request["scene"]
        return measured(request, datas[scene], works[scene], threads)

    print(f"{len(first) + len(rest)} runs; {foreseen(rows, first + rest, options.jobs)}", flush=True)
    left = {key(one): one for one in (*first, *rest)}
    with ThreadPoolExecutor(options.jobs) as pool:
        for some in (first, rest):
            for row in (ended.result() for ended in as_completed([pool.submit(row_of, one) for one in some])):
                del left[key(row)]
                rows.append(row)
                if key(row) not in done:  # a scene may be missing whose row is there
                    with options.rows.open("a") as file:
                        file.write(json.dumps(row) + "\n")
                after = foreseen(rows, list(left.values()), options.jobs)
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
    parser.add_argument(
        "--scene",
        action="append",
        default=[],
        metavar="NAME=DIR",
        help=(
            "name and folder of a COLMAP dataset; without a folder: a generated scene"
            f" ({', '.join(GENERATED)})"
        ),
    )
    parser.add_argument("--study", action="append", choices=list(STUDIES), help="default: all")
    parser.add_argument(
        "--only", action="append", metavar="WORD", help="only runs of this name, or with this word in it"
    )
    parser.add_argument(
        "--schedule",
        type=float,
        default=0.1,
        help="share of the published 30 000 + 5 000 iterations (default: 0.1)",
    )
    parser.add_argument(
        "--trained",
        type=float,
        help=f"with {', '.join(PRUNED)}: the schedule of the scene that is pruned (default: --schedule)",
    )
    parser.add_argument(
        "--start",
        choices=STARTS,
        default="3DGS",
        help="with these studies: the run of `table` whose scene is pruned (default: 3DGS)",
    )
    parser.add_argument(
        "--shrink", type=int, default=1, help="reduction of the photographs per side (default: 1)"
    )
    parser.add_argument("--seeds", type=int, default=1)
    parser.add_argument("--jobs", type=int, default=1, help="runs at a time (default: 1)")
    parser.add_argument("--part", default="1/1", metavar="K/N", help="every N-th run alone, from the K-th")
    parser.add_argument(
        "--join",
        type=Path,
        action="append",
        metavar="FILE",
        help="add the rows of this file, and run nothing",
    )
    parser.add_argument("--rows", type=Path, default=ROOT / "docs" / "results" / "rows.jsonl")
    parser.add_argument("--work", type=Path, default=ROOT / "build" / "methods")
    parser.add_argument(
        "--show",
        type=Path,
        metavar="DIR",
        help="write results.md and results/*.svg to this folder, and run nothing",
    )
    options = parser.parse_args()
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
