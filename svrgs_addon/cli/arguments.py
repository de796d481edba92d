"""The parser of the command line. Options of datasets, training and pruning come from prune/options.py.

Nothing heavy is imported here, so that every command starts at once. The list of methods is imported when a
help text shows it.
"""

from __future__ import annotations

import argparse
import re
import shutil
import sys
import textwrap
from collections.abc import Callable, Sequence
from dataclasses import fields
from typing import Any

from .. import __version__
from ..jobs.farm.engine_messages import KINDS as MESSAGES
from ..native.outputs import PICTURES
from ..prune.options import ENGINES, DatasetOptions, PruneOptions, TrainOptions, refuse_time_and_steps
from ..prune.selection.options import SelectOptions
from ..system.errors import SceneError
from ..system.exit_status import printable
from ..system.file_names import extended
from ..system.option_kinds import COLOUR, COUNT, DECIBELS, POSITIVE, SHARE, SHARES, Kind, Option, default_of, options_of
from .convert_options import ConvertOptions

NAME_WIDTH = 24  # characters of the first column of the list of methods
CHOICES = {"engine": ENGINES}
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


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence on stderr, and whose help lists the methods if a job has the
    option --method."""

    options: type | None = None  # the dataclass of options of a job

    def parse_known_args(self, args=None, namespace=None):
        found, rest = super().parse_known_args(
            _joined_numbers(sys.argv[1:] if args is None else args), namespace
        )
        if self.options is not None and "time" in found and found.time:
            try:
                refuse_time_and_steps(self.options, vars(found))
            except SceneError as error:
                self.error(str(error))
        return found, rest

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {printable(message)}\n")

    def format_help(self) -> str:
        if self.options is not None and any(action.dest == "method" for action in self._actions):
            self.formatter_class = argparse.RawDescriptionHelpFormatter  # keeps the lines of the list
            self.epilog = method_list(shutil.get_terminal_size().columns - 2)
        return super().format_help()


def _joined_numbers(words: Sequence[str]) -> list[str]:
    """The words, with '--name', '-1,2' joined to '--name=-1,2': argparse takes a list that begins with a
    minus for an option."""
    joined: list[str] = []
    for word in words:
        if re.match(r"-[.\d]", word) and "," in word and joined and re.fullmatch(r"--[a-z-]+", joined[-1]):
            joined[-1] += f"={word}"
        else:
            joined.append(word)
    return joined


def method_list(width: int) -> str:
    """All methods of the registry with their help texts, in lines of at most `width` characters."""
    from ..finetune.methods import METHODS

    indent = " " * NAME_WIDTH
    wrapped = (
        textwrap.wrap(
            f"  {name:{NAME_WIDTH - 2}}{method.label}: {method.help}",
            max(width, 2 * NAME_WIDTH),
            subsequent_indent=indent,
        )
        for name, method in METHODS.items()
    )
    return "methods:\n" + "\n".join(line for lines in wrapped for line in lines)


def parser() -> argparse.ArgumentParser:
    """The parser of `svrgs` with all its commands."""
    root = Parser(
        prog="svrgs",
        description="Makes 3D Gaussian splat scenes several times smaller, and measures the loss of quality.",
    )
    root.add_argument("--version", action="version", version=__version__)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (
        _info,
        _render,
        _train,
        _prune,
        _select,
        _convert,
        _rig,
        _eval,
        _compare,
        _farm,
        _large,
        _bench,
    ):
        add(commands)
    return root


def options_from(cls: type, words: argparse.Namespace, **more: Any) -> Any:
    """An object of a dataclass of options, from the parsed command line; defaults for options that are not
    there. more: values of further fields."""
    names = {field.name for field in fields(cls)} & set(vars(words))
    return cls(**({name: getattr(words, name) for name in names} | more))


def _command(commands, name: str, help_: str) -> Parser:
    command = commands.add_parser(name, help=help_, description=help_)
    command.add_argument(
        "--json",
        action="store_true",
        help="print the result as one JSON object on stdout, and nothing else there",
    )
    return command


def _threads(command: argparse.ArgumentParser):
    _add(command, "threads", options_of(DatasetOptions)["threads"], 0)


def _options(command: Parser, cls: type, leave_out: tuple[str, ...] = (), **required: bool):
    """Adds the options of the dataclass to the command. required: whether an option must be given, if its
    field says otherwise."""
    command.options = cls
    options = {name: option for name, option in options_of(cls).items() if name not in leave_out}
    # Python 3.11: never an empty group
    size = command.add_mutually_exclusive_group() if any(option.size for option in options.values()) else None
    for name, option in options.items():
        _add(
            size if size is not None and option.size else command,
            name,
            option,
            default_of(cls, name),
            required.get(name, option.required),
        )


def _add(command, name: str, option: Option, default: Any, required: bool = False):
    flag = f"--{name.replace('_', '-')}"
    if option.kind.type is bool:
        command.add_argument(flag, action="store_true", help=option.help)
        return
    shown = option.default_help or (
        "" if default is None or required else f"{default:g}" if isinstance(default, float) else str(default)
    )
    words: dict[str, Any] = {
        "type": _reader(option.kind),
        "default": argparse.SUPPRESS if option.steps else default,
        "required": required,
    }
    if choices := CHOICES.get(name) or option.kind.choices:
        words["choices"] = choices
    elif option.metavar:
        words["metavar"] = option.metavar
    command.add_argument(flag, help=option.help + (f" (default: {shown})" if shown else ""), **words)


def _reader(kind: Kind) -> Callable[[str], Any]:
    """The reader of the kind, with the error type of argparse."""

    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def _info(commands):
    command = _command(
        commands,
        "info",
        "Describes a splat file: format, number of Gaussians, degree of the spherical harmonics.",
    )
    _threads(command)
    command.add_argument("scene", type=extended, help="splat file")


def _render(commands):
    command = _command(
        commands, "render", "Renders a scene from its cameras: colours, spatial mask, depth, alpha."
    )
    _threads(command)
    command.add_argument("scene", type=extended, help="splat file")
    cameras = command.add_mutually_exclusive_group(required=True)
    cameras.add_argument(
        "--colmap",
        type=extended,
        metavar="DIR",
        help="dataset, COLMAP model or transforms.json; photographs are not needed",
    )
    cameras.add_argument(
        "--cameras",
        type=extended,
        metavar="JSON",
        help=(
            'cameras.json of a 3DGS run, or transforms.json; in a view of the first with "orthographic":'
            " true, fx and fy are pixels per unit of length"
        ),
    )
    command.add_argument(
        "--views",
        default="all",
        help="all, train, test, or names and numbers of views with commas between (default: all)",
    )
    command.add_argument(
        "--outputs", default="rgb", help=f"one or more of {','.join(PICTURES)} (default: rgb)"
    )
    command.add_argument(
        "--format",
        choices=("png", "exr", "npy"),
        default="png",
        help="file format; exr and npy hold exact values (default: png)",
    )
    command.add_argument(
        "--background",
        type=_reader(COLOUR),
        default=(0.0, 0.0, 0.0),
        metavar="R,G,B",
        help="background colour, 0..1 each (default: black)",
    )
    command.add_argument(
        "--out", type=extended, required=True, metavar="DIR", help="folder to write the images to"
    )


def _train(commands):
    _options(
        _command(
            commands, "train", "Trains a scene from photographs and the sparse points of their dataset."
        ),
        TrainOptions,
    )


def _prune(commands):
    command = _command(commands, "prune", "Prunes trained scenes and recovers their quality.")
    command.add_argument(
        "scenes", type=extended, nargs="+", metavar="SCENE",
        help="splat file, or folder that holds a splat and its dataset, or folder that holds such folders",
    )  # fmt: skip
    _options(command, PruneOptions, colmap=False)
    command.add_argument(
        "--out",
        type=extended,
        metavar="FILE|DIR",
        help="file for one scene, folder for several (default: SCENE_pruned.ply next to each scene)",
    )
    command.add_argument(
        "--report",
        type=extended,
        metavar="DIR",
        help="folder to write an HTML report to; with several scenes, one folder per scene in it",
    )
    command.add_argument(
        "--overwrite", action="store_true", help="with several scenes: prune those again whose output exists"
    )
    command.add_argument(
        "--batch",
        action="store_true",
        help="treat one scene like several: print one JSON line per scene and skip those whose output exists",
    )


def _select(commands):
    command = _command(
        commands,
        "select",
        "Selects the Gaussians that fulfil all given criteria, counts them, and writes them to a file.",
    )
    command.add_argument("scene", type=extended, help="splat file")
    _options(command, SelectOptions)


def _convert(commands):
    command = _command(
        commands, "convert", "Writes splats in another format; with --json, one JSON object for each."
    )
    command.add_argument(
        "inputs",
        type=extended,
        nargs="+",
        metavar="IN",
        help="splat files, folders of them, or patterns such as 'captures/*.ply'",
    )
    command.add_argument(
        "out",
        type=extended,
        metavar="OUT",
        help=(
            "file to write; with several inputs, a folder, and --to says the format, or the lod-meta.json of"
            " a streamed SOG, whose levels they become"
        ),
    )
    _options(command, ConvertOptions)


def _rig(commands):
    command = _command(commands, "rig", "Places the cameras that prune uses for a scene without photographs.")
    _threads(command)
    command.add_argument("scene", type=extended, help="splat file")
    command.add_argument(
        "--views",
        type=_reader(POSITIVE),
        metavar="N",
        help="number of cameras, each chosen by what it sees (default: 192, those of prune)",
    )
    _add(command, "seed", options_of(PruneOptions)["seed"], 0)
    command.add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="JSON",
        help="cameras.json to write; those held out for testing come last",
    )
    command.add_argument("--preview", type=extended, metavar="PNG", help="picture of the cameras to write")


def _eval(commands):
    command = _command(
        commands, "eval", "Measures the quality of a scene on photographs: PSNR, SSIM, LPIPS, FLIP."
    )
    command.add_argument("scene", type=extended, help="splat file")
    _options(command, DatasetOptions, leave_out=("image_memory",))  # it reads each photograph once
    command.add_argument(
        "--split",
        choices=("test", "train", "all"),
        default="test",
        help="views to measure on (default: test)",
    )


def _compare(commands):
    command = _command(
        commands,
        "compare",
        "Compares two scenes: pictures, differences, spatial masks and figures of quality.",
    )
    command.add_argument("a", type=extended, metavar="A", help="first splat file")
    command.add_argument("b", type=extended, metavar="B", help="second splat file")
    _options(command, DatasetOptions, colmap=False)
    help_ = (
        "without --colmap: cameras.json of 3DGS, or transforms.json; B is measured against pictures of A"
        " (default: views that are placed)"
    )
    command.add_argument("--cameras", type=extended, metavar="JSON", help=help_)
    command.add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="DIR",
        help="folder to write the pictures and the HTML page to",
    )


def _farm(commands):
    help_ = "Prunes many captures on a farm: makes a job, does tasks of it on any machine, reports on all."
    actions = commands.add_parser("farm", help=help_, description=help_).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    export = _command(
        actions,
        "export",
        "Makes a job: a folder with all settings, for Open Job Description, Deadline Cloud and Flamenco.",
    )
    export.add_argument(
        "scenes",
        type=extended,
        nargs="+",
        metavar="CAPTURE",
        help="as of svrgs prune: splats, folders of captures",
    )
    export.add_argument(
        "--out",
        type=extended,
        required=True,
        metavar="DIR",
        help="folder of the job, in which the results will be",
    )
    export.add_argument(
        "--methods",
        default="",
        metavar="NAMES",
        help="methods to compare, with commas between (default: that of svrgs prune)",
    )
    export.add_argument(
        "--targets",
        type=_reader(SHARES),
        default=(),
        metavar="SHARES",
        help="shares of the Gaussians to keep (default: the method decides)",
    )
    export.add_argument(
        "--to",
        default=".ply",
        metavar="SUFFIX",
        help="suffix of the results, which says their format (default: .ply)",
    )
    export.add_argument(
        "--no-photographs",
        action="store_true",
        help="prune on the splats' own pictures, also where there are photographs",
    )
    _options(
        export,
        PruneOptions,
        leave_out=("method", "target", "resume", "quiet", "time", "levels"),
        colmap=False,
    )
    files = _command(
        actions,
        "files",
        "Writes the files for the engines again, after a job or its captures were moved or job.json was"
        " changed.",
    )
    files.add_argument("folder", type=extended, metavar="JOB", help="folder of the job")
    files.add_argument("--root", type=extended, metavar="DIR", help="where the captures lie now")
    run = _command(
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
    report = _command(actions, "report", "Writes a table and a chart over all tasks of a job.")
    report.add_argument("folder", type=extended, metavar="JOB", help="folder of the job")


def _large(commands):
    help_ = "Prunes a scene larger than memory, by blocks on the disk."
    actions = commands.add_parser("large", help=help_, description=help_).add_subparsers(
        dest="action", required=True, metavar="ACTION"
    )
    for name, text in LARGE.items():
        command = _command(actions, name, text)
        _threads(command)
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
            cameras.add_argument("--colmap", type=extended, metavar="DIR", help=help_)
            help_ = "cameras.json of 3DGS, or transforms.json (default: as svrgs rig places cameras)"
            cameras.add_argument("--cameras", type=extended, metavar="JSON", help=help_)
            command.add_argument(
                "--block",
                type=_reader(POSITIVE),
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
        if name in ("score", "merge", "decide", "tune"):
            command.add_argument(
                "--part",
                type=_reader(COUNT),
                default=0,
                metavar="K",
                help="number of the part of the work, from 0 (default: 0)",
            )
            command.add_argument(
                "--parts",
                type=_reader(POSITIVE),
                default=1,
                metavar="N",
                help="number of all parts (default: 1)",
            )
        if name in ("prune", "tune"):
            help_ = "steps of fine-tuning, on one view each; 0: none (default: two for each view)"
            command.add_argument("--steps", type=_reader(COUNT), metavar="N", help=help_)
        if name in ("prune", "cut", "decide"):
            size = command.add_mutually_exclusive_group()
            size.add_argument(
                "--target",
                type=_reader(SHARE),
                metavar="SHARE",
                help="share of the Gaussians to keep, up to 1",
            )
            size.add_argument(
                "--target-count", type=_reader(POSITIVE), metavar="N", help="number of Gaussians to keep"
            )
        if name == "prune":
            size.add_argument(
                "--max-drop",
                type=_reader(DECIBELS),
                metavar="DB",
                help="keep as few as lose about so many dB at most",
            )
            command.add_argument(
                "--levels",
                type=_reader(SHARES),
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


def _learning(command: Parser):
    """The options of a method that decides on photographs, block by block."""
    help_ = (
        "with --colmap: the method that decides on the photographs: removal, saliency or an svr method"
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
        "background",
        "image_memory",
        "seed",
    ):
        _add(command, name, options_of(PruneOptions)[name], default_of(PruneOptions, name))


def _bench(commands):
    command = _command(
        commands, "bench", "Measures run time and numerical error, on generated scenes or a given one."
    )
    _threads(command)
    command.add_argument(
        "--scene", type=extended, metavar="FILE", help="splat file to measure instead of the generated scenes"
    )
    cameras = command.add_mutually_exclusive_group()
    cameras.add_argument(
        "--colmap",
        type=extended,
        metavar="DIR",
        help="with --scene: use the first view of this COLMAP model or transforms.json",
    )
    cameras.add_argument(
        "--cameras",
        type=extended,
        metavar="JSON",
        help="with --scene: use the first camera of this 3DGS cameras.json",
    )
    command.add_argument(
        "--repeat",
        type=_reader(POSITIVE),
        metavar="N",
        help="number of times that each stage is measured (default: 9)",
    )
    command.add_argument("--quick", action="store_true", help="measure the smallest cases only, 3 times each")
    command.add_argument(
        "--knobs",
        action="store_true",
        help="also measure other values of the constants that trade time for error; needs a C++ compiler",
    )
    command.add_argument(
        "--skips", action="store_true", help="also measure how much time each kind of skipped work saves"
    )
    command.add_argument(
        "--scaling",
        action="store_true",
        help="also measure forward time over image size, up to 4K, and over Gaussians, up to 5 million",
    )
    help_ = (
        "also measure the serial part of a picture and of a step, the speed-up of more threads, and foresee"
        " it for up to 64"
    )
    command.add_argument("--cores", action="store_true", help=help_)
    command.add_argument(
        "--interactive",
        action="store_true",
        help="also measure frames per second under an orbiting camera, and of a viewport",
    )
    command.add_argument(
        "--stress",
        action="store_true",
        help="instead: measure errors of extreme scenes, and the drift over 1,000 steps, against float64",
    )
    command.add_argument(
        "--plots",
        type=extended,
        metavar="DIR",
        help="folder to write charts to; measures knobs and skips (unless --stress is given)",
    )
