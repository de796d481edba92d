"""The options of `svrgs farm` and of `svrgs large`, whose steps a farm does one by one."""

from __future__ import annotations

from ..jobs.farm.engine_messages import KINDS as MESSAGES
from ..prune.options import GOAL, INPUT, OUTPUT, PruneOptions
from ..system.file_names import extended
from ..system.option_kinds import COUNT, DECIBELS, POSITIVE, SHARE, SHARES, default_of, options_of
from .option_parser import Parser, add_option, add_options, command_of, data_of, reader, threads_of

LARGE = {
    "prune": "Does all of it on this machine.",
    "divide": "Divides a scene into blocks. They and the cameras are written into a folder.",
    "score": (
        "Sums up what a part of the views sees of each Gaussian. Any number of machines may do the parts, in"
        " any order."
    ),
    "reduce": "Adds the sums of all parts.",
    "merge": (
        "Orders removals and merges in a part of the blocks. Any number of machines may do the parts, in any"
        " order."
    ),
    "cut": (
        "Removes and merges up to one cost for the whole scene. For a method, this stands for the blocks"
        " around one."
    ),
    "decide": (
        "Lets the method decide on the photographs in a part of the blocks. Any number of machines may do the"
        " parts, in any order."
    ),
    "tune": (
        "Fine-tunes a part of the blocks. Any number of machines may do the parts, in any order. It may be"
        " left out."
    ),
    "finish": "Joins the blocks into the result, and measures it.",
}


def farm(commands):
    help_ = "Prunes many captures on a farm: makes a job, does tasks of it on any machine, reports on all."
    actions = commands.add_parser("farm", help=help_, description=help_).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    _export(actions)
    files = command_of(
        actions,
        "files",
        "Writes the files for the engines again, after a job or its captures were moved or job.json was"
        " changed.",
    )
    files.add_argument("folder", type=extended, metavar="JOB", help="folder of the job")
    files.add_argument("--root", type=extended, metavar="DIR", help="where the captures lie now")
    run = command_of(
        actions, "run", "Does tasks of a job. What is done stays, and what was interrupted goes on."
    )
    run.add_argument("folder", type=extended, metavar="JOB", help="folder of the job")
    run.add_argument(
        "--tasks", default="", metavar="N-M", help="numbers of tasks, as in 0-3,8 (default: all)"
    )
    run.add_argument(
        "--root",
        type=extended,
        metavar="DIR",
        help="where the captures lie on this machine (default: where they lay when the job was made)",
    )
    run.add_argument(
        "--messages",
        choices=MESSAGES,
        default=MESSAGES[0],
        help=f"how progress is told (default: {MESSAGES[0]}, on stderr)",
    )
    report = command_of(actions, "report", "Writes a table and a chart over all tasks of a job.")
    report.add_argument("folder", type=extended, metavar="JOB", help="folder of the job")


def _export(actions):
    export = command_of(
        actions,
        "export",
        "Makes a job: a folder with all settings, for Open Job Description, Deadline Cloud and Flamenco.",
        grouped=True,
    )
    export.add_argument(
        "scenes",
        type=extended,
        nargs="+",
        metavar="CAPTURE",
        help="as of svrgs prune: splats, folders of captures",
    )
    export.place(OUTPUT).add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="DIR",
        help="folder of the job, in which the results will be",
    )
    export.former |= {"--method": "--methods", "--target": "--targets"}  # as of svrgs prune
    export.place(GOAL).add_argument(
        "--methods",
        default="",
        metavar="NAMES",
        help="methods to compare, with commas between (default: that of svrgs prune)",
    )
    export.place(GOAL).add_argument(
        "--targets",
        type=reader(SHARES),
        default=(),
        metavar="SHARES",
        help="shares of the Gaussians to keep (default: the method decides)",
    )
    export.place(OUTPUT).add_argument(
        "--to",
        default=".spz",
        metavar="SUFFIX",
        help="suffix of the results, which says their format (default: .spz)",
    )
    export.place(INPUT).add_argument(
        "--no-photographs",
        action="store_true",
        help="prune on the splats' own pictures, also where there are photographs",
    )
    add_options(
        export,
        PruneOptions,
        leave_out=("method", "target", "resume", "quiet", "time", "levels"),
        data=False,
    )


def large(commands):
    help_ = "Prunes a scene larger than memory, by blocks on the disk."
    actions = commands.add_parser("large", description=help_).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    for name, text in LARGE.items():
        command = command_of(actions, name, text)
        threads_of(command)
        command.add_argument(
            "--messages",
            choices=MESSAGES,
            default=MESSAGES[0],
            help=f"how progress is told (default: {MESSAGES[0]}, on stderr)",
        )
        if name in ("prune", "divide"):
            command.add_argument("scene", type=extended, help="splat file")
            _learning(command)
            cameras = command.add_mutually_exclusive_group()
            help_ = (
                "dataset, COLMAP model or transforms.json, for its cameras; with --method, for its"
                " photographs too"
            )
            data_of(command, cameras, help_)
            help_ = "cameras.json of 3DGS, or transforms.json (default: as svrgs rig places cameras)"
            cameras.add_argument("--cameras", type=extended, metavar="JSON", help=help_)
            command.add_argument(
                "--block",
                type=reader(POSITIVE),
                default=2_000_000,
                metavar="N",
                help="Gaussians of a block, at most (default: 2000000)",
            )
        if name == "prune":
            command.add_argument(
                "--work",
                type=extended,
                metavar="DIR",
                help="folder for the blocks, deleted at the end (default: OUT.blocks)",
            )
        elif name == "divide":
            command.add_argument(
                "--work", type=extended, required=True, metavar="DIR", help="folder for the blocks"
            )
        else:
            command.add_argument("work", type=extended, metavar="WORK", help="folder of the blocks")
        _parts(command, name)
        _goal(command, name)


def _learning(command: Parser):
    """The options of a method that decides on photographs, block by block."""
    help_ = (
        "with --data: the method that decides on the photographs: removal, saliency or an svr method"
        " (default: removals and merges by their costs)"
    )
    command.add_argument("--method", default="", metavar="NAME", help=help_)
    for name in (
        "lambda_f",
        "iterations",
        "recovery",
        "schedule",
        "min_contribution",
        "images",
        "holdout",
        "masks",
        "invert_masks",
        "outside",
        "background",
        "image_memory",
        "seed",
        "force",
    ):
        add_option(command, command, name, options_of(PruneOptions)[name], default_of(PruneOptions, name))


def _parts(command: Parser, name: str):
    """Which part of the work a call does, and its steps."""
    if name in ("score", "merge", "decide", "tune"):
        command.add_argument(
            "--part",
            type=reader(COUNT),
            default=0,
            metavar="K",
            help="number of the part of the work, from 0 (default: 0)",
        )
        command.add_argument(
            "--parts",
            type=reader(POSITIVE),
            default=1,
            metavar="N",
            help="number of all parts (default: 1)",
        )
    if name in ("prune", "tune"):
        help_ = "steps of fine-tuning, on one view each; 0: none (default: two for each view)"
        command.former["--steps"] = "--tuning-steps"
        command.add_argument("--tuning-steps", dest="steps", type=reader(COUNT), metavar="N", help=help_)


def _goal(command: Parser, name: str):
    """How many Gaussians stay, and where the result goes."""
    if name in ("prune", "cut", "decide"):
        size = command.add_mutually_exclusive_group()
        size.add_argument(
            "--target",
            type=reader(SHARE),
            metavar="SHARE",
            help="share of the Gaussians to keep, up to 1",
        )
        size.add_argument(
            "--target-count", type=reader(POSITIVE), metavar="N", help="number of Gaussians to keep"
        )
    if name == "prune":
        size.add_argument(
            "--max-drop",
            type=reader(DECIBELS),
            metavar="DB",
            help="keep as few as lose about so many dB at most",
        )
        command.add_argument(
            "--levels",
            type=reader(SHARES),
            default=(),
            metavar="SHARES",
            help="levels of detail, as of svrgs prune",
        )
        command.add_argument(
            "--resume",
            action="store_true",
            help="with --method: continue the same job after a stop; without it, the job starts again",
        )
    if name in ("prune", "finish"):
        command.add_argument(
            "--out", type=extended, required=True, metavar="FILE", help="splat file to write"
        )
