"""The options of `svrgs farm` and of `svrgs large`, whose steps a farm does one by one."""

from __future__ import annotations

from ..jobs.farm.engine_messages import KINDS as MESSAGES
from ..prune.options import GOAL, INPUT, OUTPUT, PruneOptions
from ..system.option_kinds import COUNT, DECIBELS, PATH, POSITIVE, SHARE, SHARES
from .option_parser import (
    Parser,
    add_flags,
    add_options,
    add_some,
    add_value,
    command_of,
    data_of,
    threads_of,
)

ANY_MACHINE = "Any number of machines may do the parts, in any order."
LARGE = {
    "prune": "Does all of it on this machine.",
    "divide": "Divides a scene into blocks. They and the cameras are written into a folder.",
    "score": f"Sums up what a part of the views sees of each Gaussian. {ANY_MACHINE}",
    "reduce": "Adds the sums of all parts.",
    "merge": f"Orders removals and merges in a part of the blocks. {ANY_MACHINE}",
    "cut": (
        "Removes and merges up to one cost for the whole scene. For a method, this stands for the blocks"
        " around one."
    ),
    "decide": f"Lets the method decide on the photographs in a part of the blocks. {ANY_MACHINE}",
    "tune": f"Fine-tunes a part of the blocks. {ANY_MACHINE} It may be left out.",
    "finish": "Joins the blocks into the result, and measures it.",
}


def farm(commands):
    text = "Prunes many captures on a farm: makes a job, does tasks of it on any machine, reports on all."
    actions = commands.add_parser("farm", help=text, description=text).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    _export(actions)
    text = (
        "Writes the files for the engines again, after a job or its captures were moved or job.json was"
        " changed."
    )
    files = _of_job(actions, "files", text)
    add_value(files, "--root", PATH, "where the captures lie now", metavar="DIR")
    text = "Does tasks of a job. What is done stays, and what was interrupted goes on."
    run = _of_job(actions, "run", text)
    run.add_argument(
        "--tasks", default="", metavar="N-M", help="numbers of tasks, as in 0-3,8 (default: all)"
    )
    help_ = "where the captures lie on this machine (default: where they lay when the job was made)"
    add_value(run, "--root", PATH, help_, metavar="DIR")
    _messages(run)
    _of_job(actions, "report", "Writes a table and a chart over all tasks of a job.")


def _of_job(actions, name: str, text: str) -> Parser:
    """A new action, on a job that is there."""
    command = command_of(actions, name, text)
    add_value(command, "folder", PATH, "folder of the job", metavar="JOB")
    return command


def _messages(command: Parser):
    help_ = f"how progress is told (default: {MESSAGES[0]}, on stderr)"
    command.add_argument("--messages", choices=MESSAGES, default=MESSAGES[0], help=help_)


def _export(actions):
    text = "Makes a job: a folder with all settings, for Open Job Description, Deadline Cloud and Flamenco."
    export = command_of(actions, "export", text, grouped=True)
    goal, output = export.place(GOAL), export.place(OUTPUT)
    help_ = "as of svrgs prune: splats, folders of captures"
    add_value(export, "scenes", PATH, help_, metavar="CAPTURE", nargs="+")
    help_ = "folder of the job, in which the results will be"
    add_value(output, "--out", PATH, help_, metavar="DIR", required=True)
    export.former |= {"--method": "--methods", "--target": "--targets"}  # as of svrgs prune
    help_ = "methods to compare, with commas between (default: that of svrgs prune)"
    goal.add_argument("--methods", default="", metavar="NAMES", help=help_)
    help_ = "shares of the Gaussians to keep (default: the method decides)"
    add_value(goal, "--targets", SHARES, help_, default=())
    help_ = "suffix of the results, which says their format (default: .spz)"
    output.add_argument("--to", default=".spz", metavar="SUFFIX", help=help_)
    add_flags(
        export.place(INPUT),
        no_photographs="prune on the splats' own pictures, also where there are photographs",
    )
    left_out = ("method", "target", "resume", "quiet", "time", "levels")
    add_options(export, PruneOptions, left_out, data=False)


def large(commands):
    text = "Prunes a scene larger than memory, by blocks on the disk."
    actions = commands.add_parser("large", description=text).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    for name, text in LARGE.items():
        command = command_of(actions, name, text)
        threads_of(command)
        _messages(command)
        if name in ("prune", "divide"):
            _scene(command)
        if name == "prune":
            help_ = "folder for the blocks, deleted at the end (default: OUT.blocks)"
            add_value(command, "--work", PATH, help_, metavar="DIR")
        elif name == "divide":
            add_value(command, "--work", PATH, "folder for the blocks", metavar="DIR", required=True)
        else:
            add_value(command, "work", PATH, "folder of the blocks", metavar="WORK")
        _parts(command, name)
        _goal(command, name)


def _scene(command: Parser):
    """The scene, the method that decides on its photographs, block by block, its views, and the blocks."""
    add_value(command, "scene", PATH, "splat file")
    help_ = (
        "with --data: the method that decides on the photographs: removal, saliency or an svr method"
        " (default: removals and merges by their costs)"
    )
    command.add_argument("--method", default="", metavar="NAME", help=help_)
    add_some(
        command, PruneOptions, "lambda_f", "iterations", "recovery", "schedule", "min_contribution", "images",
        "holdout", "masks", "invert_masks", "outside", "background", "image_memory", "seed", "force",
    )  # fmt: skip
    cameras = command.add_mutually_exclusive_group()
    help_ = (
        "dataset, COLMAP model or transforms.json, for its cameras; with --method, for its photographs too"
    )
    data_of(command, cameras, help_)
    help_ = "cameras.json of 3DGS, or transforms.json (default: as svrgs rig places cameras)"
    add_value(cameras, "--cameras", PATH, help_, metavar="JSON")
    add_value(
        command, "--block", POSITIVE, "Gaussians of a block, at most (default: 2000000)", default=2_000_000
    )


def _parts(command: Parser, name: str):
    """Which part of the work a call does, and its steps."""
    if name in ("score", "merge", "decide", "tune"):
        help_ = "number of the part of the work, from 0 (default: 0)"
        add_value(command, "--part", COUNT, help_, metavar="K", default=0)
        add_value(command, "--parts", POSITIVE, "number of all parts (default: 1)", default=1)
    if name in ("prune", "tune"):
        help_ = "steps of fine-tuning, on one view each; 0: none (default: two for each view)"
        command.former["--steps"] = "--tuning-steps"
        add_value(command, "--tuning-steps", COUNT, help_, dest="steps")


def _goal(command: Parser, name: str):
    """How many Gaussians stay, and where the result goes."""
    if name in ("prune", "cut", "decide"):
        size = command.add_mutually_exclusive_group()
        add_value(size, "--target", SHARE, "share of the Gaussians to keep, up to 1")
        add_value(size, "--target-count", POSITIVE, "number of Gaussians to keep")
    if name == "prune":
        add_value(size, "--max-drop", DECIBELS, "keep as few as lose about so many dB at most")
        add_value(command, "--levels", SHARES, "levels of detail, as of svrgs prune", default=())
        add_flags(
            command,
            resume="with --method: continue the same job after a stop; without it, the job starts again",
        )
    if name in ("prune", "finish"):
        add_value(command, "--out", PATH, "splat file to write", metavar="FILE", required=True)
