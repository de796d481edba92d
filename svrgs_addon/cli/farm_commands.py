"""`svrgs farm export`, `files`, `run` and `report`: many captures, methods and targets, for the machines of a
farm."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from ..files.registry import format_to_write
from ..jobs.farm.engine_messages import Messages
from ..jobs.farm.engines import memory_of, write_engine_files
from ..jobs.farm.farm_job import FarmJob, common_folder, refuse_folder, tasks_of
from ..jobs.farm.run_tasks import numbers_of, run_tasks
from ..jobs.farm.summary import summarise
from ..prune.door import allowed_loss, check_view_options
from ..prune.options import PruneOptions
from ..prune.pipeline import in_memory
from ..prune.plans import method_of
from ..system.errors import SceneError, SplatError
from ..system.memory import size_text
from .batch_list import expand
from .option_parser import options_from


def farm(args: argparse.Namespace) -> dict[str, Any]:
    """Does one action. Raises SplatError, Cancelled."""
    return {"export": _export, "files": _files, "run": _run, "report": _report}[args.action](args)


def as_text(args: argparse.Namespace, result: dict[str, Any]) -> str:
    """The result in a sentence; of a run, its messages have said everything."""
    if args.action in ("export", "files"):
        return (
            f"tasks: {result['tasks']}; memory of each: up to {size_text(result['memory'])}; saved"
            f" {result['folder']}"
        )
    if args.action == "report":
        return result["report"]
    return "\n".join(f"{one['sha256']}  {one['out']}" for one in result["tasks"])


def _export(args: argparse.Namespace) -> dict[str, Any]:
    folder: Path = args.out
    refuse_folder(folder)
    suffix = args.to if args.to.startswith(".") else f".{args.to}"
    format_to_write(f"x{suffix}")
    options = options_from(PruneOptions, args)
    if args.targets and (options.target_count or options.target_size or allowed_loss(options).loss):
        raise SceneError(
            "--targets and --target-count, --target-size or an allowed loss each say how many Gaussians stay:"
            " leave one out"
        )
    items = expand(args.scenes, args.data, folder / "results")
    folders = [item.scene.absolute().parent for item in items]
    folders += [path.absolute() for path in args.scenes if path.is_dir()]  # also if it holds one capture
    folders += [item.data.absolute() for item in items if item.data]
    root = common_folder(folders) or folders[0]
    scenes = [(item.name, item.scene, None if args.no_photographs else item.data) for item in items]
    ways = list(_ways(args))
    job = FarmJob(folder.absolute(), root, tasks_of(root, scenes, ways, options), suffix)
    for task in job.tasks:
        check_view_options(job.options(task))
    for task in job.tasks[: len(ways)]:  # those of the first scene: refuses what each way would refuse
        in_memory(job.options(task))
    return _write(job)


def _files(args: argparse.Namespace) -> dict[str, Any]:
    return _write(FarmJob.read(args.folder.absolute(), args.root and args.root.absolute()))


def _write(job: FarmJob) -> dict[str, Any]:
    """Writes job.json and the files of the engines."""
    needed = max(memory_of(one) for one in {one.scene: one for one in map(job.options, job.tasks)}.values())
    job.write()
    write_engine_files(job, needed)
    facts = {"folder": str(job.folder), "tasks": len(job.tasks), "memory": needed}
    return facts | {"names": [task.name for task in job.tasks]}


def _ways(args: argparse.Namespace) -> Iterator[dict[str, Any]]:
    """The methods times the targets. Raises SceneError for a method that there is not."""
    for method in args.methods.split(",") if args.methods else [""]:
        method_of(PruneOptions(method=method))
        for target in args.targets or [None]:
            yield ({"method": method} if method else {}) | ({"target": target} if target else {})


def _run(args: argparse.Namespace) -> dict[str, Any]:
    job, messages = FarmJob.read(args.folder, args.root), Messages(args.messages)
    numbers = numbers_of(args.tasks, len(job.tasks)) if args.tasks else list(range(len(job.tasks)))
    try:
        return {"tasks": run_tasks(job, numbers, messages)}
    except SplatError as error:
        messages.fail(str(error))
        raise


def _report(args: argparse.Namespace) -> dict[str, Any]:
    return summarise(FarmJob.read(args.folder))
