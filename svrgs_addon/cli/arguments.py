"""The command line's words. Options of datasets, training and pruning come from jobs/options.py; nothing heavy is imported here."""

from __future__ import annotations

import argparse
from collections.abc import Callable
from dataclasses import fields
from pathlib import Path
from typing import Any

from .. import __version__
from ..jobs.options import ENGINES, DatasetOptions, PruneOptions, TrainOptions
from ..option_kinds import COLOUR, POSITIVE, Kind, Option, default_of, options_of

LEARNED = "svr, svr-self, svr-even, svr-a, svr-b, saliency, maskgs (also -alpha, -beta, -gamma), compact3dgs, gns"
RANKED = "lightgaussian, pup, contribution, max-contribution, opacity"
METHOD_HELP = f"pressure; learned: {LEARNED}; by a score, once: {RANKED}; none: 3dgs"
CHOICES = {"engine": ENGINES}


class Parser(argparse.ArgumentParser):
    def error(self, message: str):
        self.exit(2, f"{self.prog}: {message}\n")


def parser() -> argparse.ArgumentParser:
    root = Parser(prog="svrgs", description="Makes 3D Gaussian splat scenes several times smaller, and says what it cost.")
    root.add_argument("--version", action="version", version=__version__)
    commands = root.add_subparsers(dest="command", required=True, metavar="COMMAND")
    for add in (_info, _render, _train, _prune, _eval, _compare, _bench):
        add(commands)
    return root


def options_from(cls: type, words: argparse.Namespace, **more: Any) -> Any:
    """An object of a dataclass of options from parsed words; more: further fields."""
    names = {field.name for field in fields(cls)} & set(vars(words))
    return cls(**({name: getattr(words, name) for name in names} | more))


def _command(commands, name: str, help_: str) -> argparse.ArgumentParser:
    command = commands.add_parser(name, help=help_, description=help_)
    command.add_argument("--json", action="store_true", help="print one JSON object on stdout and nothing else there")
    return command


def _threads(command: argparse.ArgumentParser):
    _add(command, "threads", options_of(DatasetOptions)["threads"], 0)


def _options(command: argparse.ArgumentParser, cls: type, **required: bool):
    """Adds every option of the dataclass; required: whether an option must be given, against what its field says."""
    size = command.add_mutually_exclusive_group()
    for name, option in options_of(cls).items():
        _add(size if option.size else command, name, option, default_of(cls, name), required.get(name, option.required))


def _add(command, name: str, option: Option, default: Any, required: bool = False):
    flag = f"--{name.replace('_', '-')}"
    if option.kind.type is bool:
        command.add_argument(flag, action="store_true", help=option.help)
        return
    help_ = METHOD_HELP if name == "method" else option.help
    shown = option.default_help or ("" if default is None or required else f"{default:g}" if isinstance(default, float) else str(default))
    words: dict[str, Any] = {"type": _reader(option.kind), "default": default, "required": required}
    if choices := CHOICES.get(name) or option.kind.choices:
        words["choices"] = choices
    elif option.metavar:
        words["metavar"] = option.metavar
    command.add_argument(flag, help=help_ + (f" (default: {shown})" if shown else ""), **words)


def _reader(kind: Kind) -> Callable[[str], Any]:
    """The kind's reader with argparse's own error."""

    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read


def _info(commands):
    command = _command(commands, "info", "Says what is in a splat file.")
    _threads(command)
    command.add_argument("scene", type=Path)


def _render(commands):
    command = _command(commands, "render", "Renders a scene from its cameras: colours, spatial mask, depth, alpha.")
    _threads(command)
    command.add_argument("scene", type=Path)
    cameras = command.add_mutually_exclusive_group(required=True)
    cameras.add_argument("--colmap", type=Path, metavar="DIR", help="COLMAP dataset or model; photographs are not needed")
    cameras.add_argument(
        "--cameras", type=Path, metavar="JSON", help='cameras.json of a 3DGS run; with "orthographic": true in a view, fx and fy are pixels per unit'
    )
    command.add_argument("--views", default="all", help="all, train, test, or image names and positions, comma-separated (default: all)")
    command.add_argument("--outputs", default="rgb", help="any of rgb,mask,depth,alpha (default: rgb)")
    command.add_argument("--format", choices=("png", "exr", "npy"), default="png")
    command.add_argument("--background", type=_reader(COLOUR), default=(0.0, 0.0, 0.0), metavar="R,G,B", help="0..1 each (default: black)")
    command.add_argument("--out", type=Path, required=True, metavar="DIR")


def _train(commands):
    _options(_command(commands, "train", "Trains a scene from photographs and COLMAP's sparse points."), TrainOptions)


def _prune(commands):
    command = _command(commands, "prune", "Prunes trained scenes and recovers their quality.")
    command.add_argument("scenes", type=Path, nargs="+", metavar="SCENE", help="splat files, folders of a splat and its COLMAP dataset, or folders of such")
    _options(command, PruneOptions, colmap=False)
    command.add_argument("--out", type=Path, metavar="FILE|DIR", help="a file for one scene, a folder for several (default: beside each scene)")
    command.add_argument("--report", type=Path, metavar="DIR", help="write an HTML page there (one folder a scene if there are several)")
    command.add_argument("--overwrite", action="store_true", help="with several scenes: also those whose output exists")
    command.add_argument("--batch", action="store_true", help="treat a single scene like several: a JSON line each, finished ones skipped")


def _eval(commands):
    command = _command(commands, "eval", "Measures a scene against photographs.")
    command.add_argument("scene", type=Path)
    _options(command, DatasetOptions)
    command.add_argument("--split", choices=("test", "train", "all"), default="test")


def _compare(commands):
    command = _command(commands, "compare", "Two scenes side by side: pictures, differences, spatial masks, figures.")
    command.add_argument("a", type=Path, metavar="A")
    command.add_argument("b", type=Path, metavar="B")
    _options(command, DatasetOptions)
    command.add_argument("--out", type=Path, required=True, metavar="DIR")


def _bench(commands):
    command = _command(commands, "bench", "Measures run time against error, on generated scenes or a given one.")
    _threads(command)
    command.add_argument("--scene", type=Path, metavar="FILE", help="a splat file instead of the generated scenes")
    cameras = command.add_mutually_exclusive_group()
    cameras.add_argument("--colmap", type=Path, metavar="DIR", help="look at the scene from this model's first view")
    cameras.add_argument("--cameras", type=Path, metavar="JSON", help="look at it from the first camera of a 3DGS cameras.json")
    command.add_argument("--repeat", type=_reader(POSITIVE), metavar="N", help="times each stage is run (default: 9)")
    command.add_argument("--quick", action="store_true", help="the smallest cases only, 3 times each")
    command.add_argument("--knobs", action="store_true", help="also run time against error for every constant that trades one for the other; needs a compiler")
    command.add_argument("--skips", action="store_true", help="also what each kind of skipped work saves")
    command.add_argument("--scaling", action="store_true", help="also forward time against pixels and Gaussians, up to 4K and 5 million")
    command.add_argument("--interactive", action="store_true", help="also pictures a second of a million Gaussians under an orbiting camera")
    command.add_argument("--stress", action="store_true", help="instead: errors of hostile scenes, and the drift of 1,000 steps, against float64")
    command.add_argument("--plots", type=Path, metavar="DIR", help="measure knobs and skips (unless --stress), and draw the charts there")
