"""Whole jobs, measured in processes of their own: speed, memory, quality, time outside the native core, and
the effect of each variant.

    .venv/bin/python benchmarks/jobs.py --data DIR [--iterations N] [--prune] [--skips] [--seeds N] [--json]

`python -m tests.demo_scene DIR` makes a dataset. Figures go to stdout, progress to stderr. With --skips the
training job (and with
--prune the pruning job) is repeated in several variants that skip or reorder work. With --seeds each figure
is the mean of N seeds; the
spread of one variant over its seeds shows how large random differences are.
"""

from __future__ import annotations

import argparse
import json
import os
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

import files

HERE = Path(__file__).resolve().parent
VALUES_PER_GAUSSIAN = 59  # at SH degree 3
MB = 2**20


def request(options: argparse.Namespace, kind: str, out: Path, seed: int = 0, **changes) -> dict:
    """A request for one_job.py. changes: further or other entries."""
    steps, recovery = (
        (options.iterations, 0) if kind == "train" else (options.prune_iterations, options.prune_iterations)
    )
    job = dict(
        data=str(options.data), out=str(out), kind=kind, iterations=steps, recovery=recovery, seed=seed
    )
    return {**job, "profile": False, "phase": {}, "run": {}, **changes}


def answer(job: dict) -> dict:
    """The result of a job, which runs in a process of its own. It ends the program if the job fails."""
    print(f"{job['kind']} {job['phase']} {job['run']} seed {job['seed']} ...", file=sys.stderr, flush=True)
    environment = {**os.environ, "PYTHONPATH": str(HERE.parent)}
    done = subprocess.run(
        [sys.executable, HERE / "one_job.py"],
        input=json.dumps(job),
        capture_output=True,
        text=True,
        env=environment,
    )
    if done.returncode:
        sys.exit(f"{job['kind']} failed: {done.stderr.strip().splitlines()[-1]}")
    return json.loads(done.stdout)


def job_figures(result: dict) -> dict:
    """The figures of a job that are shown: speed, quality, memory relative to the arrays of the scene, shares
    of the time."""
    scene_bytes = result["largest_count"] * VALUES_PER_GAUSSIAN * 4
    work = result["peak_memory_bytes"] - result["base_memory_bytes"] - result["image_bytes"]
    total, native = result["seconds"], sum(result["native_seconds"].values())
    return {
        "iterations_per_second": result["iterations_per_second"],
        "seconds": total,
        "psnr": result["psnr"],
        "count": result["count"],
        "largest_count": result["largest_count"],
        "peak_memory_bytes": result["peak_memory_bytes"],
        "memory_before_bytes": result["base_memory_bytes"],
        "image_bytes": result["image_bytes"],
        "scene_bytes": scene_bytes,
        "memory_in_scenes": work / scene_bytes,
        "native_share": native / total,
        "native": {name: seconds / total for name, seconds in result["native_seconds"].items()},
        "stages": {name: seconds / total for name, seconds in result["stage_seconds"].items()},
        "seconds_by_phase": result["seconds_by_phase"],
    }


def train_variants(iterations: int) -> dict[str, dict]:
    """Variants of the training job: name, and the entries of the request that it changes."""
    early, half = iterations // 5, iterations // 2
    return {
        "plain": {},
        "no Morton order": {"run": {"spatial_order": False}},
        f"1/2 size until {early}": {"phase": {"coarse_until": early}},
        f"1/2 size until {half}": {"phase": {"coarse_until": half}},
        f"1/4, then 1/2 until {half}": {"phase": {"coarse_until": half, "coarse_factor": 4}},
        "views by loss": {"run": {"views_by_loss": True}},
        f"1/2 until {half}, views by loss": {"phase": {"coarse_until": half}, "run": {"views_by_loss": True}},
    }


PRUNE_VARIANTS = {
    "plain": {},
    "no Morton order": {"run": {"spatial_order": False}},
    "events every 100": {"phase": {"prune_every": 100}},
    "views by loss": {"run": {"views_by_loss": True}},
}


def compared(options: argparse.Namespace, kind: str, variants: dict, out: Path, **job) -> list[dict]:
    """Of each variant, means over the seeds: seconds of fine-tuning, PSNR in dB and its spread over seeds,
    Gaussians left."""
    rows = []
    for name, changes in variants.items():
        results = [
            answer(request(options, kind, out, seed, **job, **changes)) for seed in range(options.seeds)
        ]
        psnr = [result["psnr"] for result in results]
        rows.append({
            "variant": name,
            "seconds": statistics.fmean(one["iterations"] / one["iterations_per_second"] for one in results),
            "psnr": statistics.fmean(psnr),
            "psnr_spread": max(psnr) - min(psnr),
            "count": statistics.fmean(result["count"] for result in results),
        })  # fmt: skip
    return rows


def measure(options: argparse.Namespace, folder: Path) -> dict:
    """All figures that the options ask for. folder: for the files of the jobs."""
    trained, pruned = options.scene or folder / "trained.ply", folder / "pruned.ply"
    found = {}
    if not options.scene:
        found["train"] = job_figures(answer(request(options, "train", trained, profile=True)))
    if options.prune:
        found["prune"] = job_figures(
            answer(request(options, "prune", pruned, scene=str(trained), profile=True))
        )
    if options.skips:
        if not options.scene:
            found["train_skips"] = compared(
                options, "train", train_variants(options.iterations), folder / "variant.ply"
            )
        if options.prune:
            found["prune_skips"] = compared(
                options, "prune", PRUNE_VARIANTS, folder / "variant.ply", scene=str(trained)
            )
    return found | {"start_up": files.start_up(Path(trained)), "ply": files.ply_times()}


def job_text(kind: str, job: dict) -> str:
    lines = [
        (
            f"{kind}: {job['iterations_per_second']:.1f} iterations/s, {job['seconds']:.0f} s, PSNR"
            f" {job['psnr']:.2f} dB, {job['count']:,} Gaussians"
        ),
        (
            f"  peak memory {job['peak_memory_bytes'] / MB:.0f} MB: {job['memory_before_bytes'] / MB:.0f}"
            f" before the job, {job['image_bytes'] / MB:.0f} photographs,"
            f" {job['memory_in_scenes'] * job['scene_bytes'] / MB:.0f} work = {job['memory_in_scenes']:.1f}"
            f" times the arrays of {job['largest_count']:,} Gaussians ({job['scene_bytes'] / MB:.0f} MB)"
        ),
        f"  {1 - job['native_share']:.1%} of the time outside the native core",
    ]
    for title, shares in (("native", job["native"]), ("outside", job["stages"])):
        lines += [f"    {title:8} {name:32} {share:6.1%}" for name, share in shares.items() if share >= 0.002]
    return "\n".join(lines)


def skips_text(kind: str, rows: list[dict]) -> str:
    plain = rows[0]
    lines = [
        f"{kind}: variants",
        f"  {'':32} {'seconds':>8} {'':>7} {'PSNR dB':>8} {'':>7} {'spread':>7} {'Gaussians':>10}",
    ]
    for row in rows:
        faster, better = row["seconds"] / plain["seconds"] - 1, row["psnr"] - plain["psnr"]
        lines.append(
            f"  {row['variant']:32} {row['seconds']:8.1f} {faster:+7.1%} {row['psnr']:8.2f} {better:+7.2f}"
            f" {row['psnr_spread']:7.2f} {row['count']:10,.0f}"
        )
    return "\n".join(lines)


def as_text(found: dict) -> str:
    parts = [job_text(kind, found[kind]) for kind in ("train", "prune") if kind in found]
    parts += [
        skips_text(kind, found[f"{kind}_skips"]) for kind in ("train", "prune") if f"{kind}_skips" in found
    ]
    start, ply = found["start_up"], found["ply"]
    parts.append(
        f"svrgs info: {start['info_seconds'] * 1e3:.0f} ms (Python alone {start['python_seconds'] * 1e3:.0f}"
        f" ms), {start['modules']} modules, third-party: {', '.join(start['third_party'])}"
    )
    parts.append(
        f"PLY of {ply['count']:,} Gaussians, {ply['bytes'] / 1e6:.0f} MB: written in"
        f" {ply['write_seconds']:.2f} s, read in {ply['read_seconds']:.2f} s"
    )
    return "\n\n".join(parts)


def parsed() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--data", type=Path, required=True, metavar="DIR")
    parser.add_argument(
        "--scene", type=Path, metavar="FILE", help="prune this scene; without it, a scene is trained first"
    )
    parser.add_argument(
        "--iterations", type=int, default=2500, metavar="N", help="training steps (default: 2500)"
    )
    parser.add_argument("--prune", action="store_true", help="also prune")
    parser.add_argument(
        "--prune-iterations",
        type=int,
        default=1000,
        metavar="N",
        help="steps of mask learning, and steps of recovery (default: 1000)",
    )
    parser.add_argument("--skips", action="store_true", help="also measure variants of the jobs")
    parser.add_argument(
        "--seeds", type=int, default=1, metavar="N", help="seeds to average over with --skips (default: 1)"
    )
    parser.add_argument("--json", action="store_true")
    return parser.parse_args()


def main():
    options = parsed()
    with tempfile.TemporaryDirectory() as folder:
        found = measure(options, Path(folder))
    print(json.dumps(found) if options.json else as_text(found))


if __name__ == "__main__":
    main()
