"""The parser of one command, and options of dataclasses as options of the command line.

Nothing heavy is imported here, so that every command starts at once.
"""

from __future__ import annotations

import argparse
import re
import sys
from collections.abc import Callable, Sequence
from copy import copy
from dataclasses import fields
from typing import Any

from ..prune.options import ENGINES, GROUPS, OUTPUT, DatasetOptions, refuse_time_and_steps
from ..system import option_kinds as kinds
from ..system.errors import SceneError
from ..system.exit_status import printable
from ..system.option_kinds import PATH, Kind, Option, default_of, options_of

CHOICES = {"engine": ENGINES}
# what --help shows for a value of a kind, where nothing else is said
METAVARS = {
    kinds.BOX: "X,Y,Z,X,Y,Z", kinds.COLOUR: "R,G,B", kinds.COUNT: "N", kinds.DECIBELS: "DB",
    kinds.FACTOR: "X", kinds.FILE: "FILE", kinds.GIGABYTES: "GB", kinds.MEGABYTES: "MB", kinds.POINT: "X,Y,Z",
    kinds.POSITIVE: "N", kinds.POSITIVE_FLOAT: "FACTOR", kinds.RANGE: "LO,HI", kinds.SECONDS: "SECONDS",
    kinds.SHARE: "SHARE", kinds.SHARES: "SHARES", kinds.SMALLER_SHARE: "SHARE",
}  # fmt: skip
MORE = "More"  # heading of the options that --help leaves out


class Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence on stderr. With groups(), its --help shows the most used options
    alone, with the first clause of their help texts; --help-all shows everything."""

    options: type | None = None  # the dataclass of options of a job

    def __init__(self, *args, **more):
        self.former: dict[str, str] = {}  # older names of options, which are still read
        self.grouped: dict[str, argparse._ArgumentGroup] = {}
        super().__init__(*args, **more)

    def groups(self):
        """Sorts the options that are added from now on by the groups of their fields."""
        self.grouped = {title: self.add_argument_group(title) for title in (*GROUPS, MORE)}
        self.add_argument("--help-all", action=_HelpAll, help="show all options and exit")

    def place(self, group: str) -> argparse._ActionsContainer:
        """Where an option of this group is added."""
        return self.grouped[group or MORE] if self.grouped else self

    def parse_known_args(self, args=None, namespace=None):
        words = _joined_numbers(sys.argv[1:] if args is None else args)
        found, rest = super().parse_known_args([self._newer(word) for word in words], namespace)
        if self.options is not None and "time" in found and found.time:
            try:
                refuse_time_and_steps(self.options, vars(found))
            except SceneError as error:
                self.error(str(error))
        return found, rest

    def _newer(self, word: str) -> str:
        """The word with today's name of an option that has an older one."""
        name, equals, value = word.partition("=")
        return self.former.get(name, name) + equals + value

    def error(self, message: str):
        self.exit(2, f"{self.prog}: {printable(message)}\n")

    def format_help(self) -> str:
        return self._brief_help() if self.grouped else super().format_help()

    def full_help(self) -> str:
        return super().format_help()

    def _brief_help(self) -> str:
        positionals = [action for action in self._actions if not action.option_strings]
        formatter = self._get_formatter()
        formatter.add_usage(" ".join([self.prog, *map(_shown, positionals), "[options]"]), [], [])
        formatter.add_text(self.description)
        groups = ((name, self.grouped[name]._group_actions) for name in GROUPS)
        for title, actions in [("", positionals), *groups]:
            formatter.start_section(title or None)
            formatter.add_arguments([_briefly(action) for action in actions])
            formatter.end_section()
        formatter.add_text("All options: --help-all. The methods: svrgs methods.")
        return formatter.format_help()


class _HelpAll(argparse.Action):
    def __init__(self, option_strings, dest, **more):
        super().__init__(option_strings, argparse.SUPPRESS, nargs=0, default=argparse.SUPPRESS, **more)

    def __call__(self, parser, namespace, values, option_string=None):
        parser._print_message(parser.full_help(), sys.stdout)
        parser.exit()


def _shown(action: argparse.Action) -> str:
    return f"{action.metavar or action.dest}{' ...' if action.nargs == '+' else ''}"


def _briefly(action: argparse.Action) -> argparse.Action:
    brief = copy(action)
    brief.help = getattr(action, "brief", action.help)
    return brief


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


def options_from(cls: type, args: argparse.Namespace, **more: Any) -> Any:
    """An object of a dataclass of options, from the parsed command line; defaults for options that are not
    there. more: values of further fields."""
    names = {field.name for field in fields(cls)} & set(vars(args))
    return cls(**({name: getattr(args, name) for name in names} | more))


def command_of(commands, name: str, help_: str, grouped: bool = False) -> Parser:
    """A new command. grouped: its options stand in groups."""
    command = commands.add_parser(name, description=help_, help=help_)
    if grouped:
        command.groups()
    add_flags(
        command.place(OUTPUT), json="print the result as one JSON object on stdout, and nothing else there"
    )
    return command


def threads_of(command: Parser):
    add_some(command, DatasetOptions, "threads")


def add_value(container, name: str, kind: Kind, help_: str, **more: Any):
    """Adds an argument with a value to the command or group. more: for add_argument()."""
    container.add_argument(name, type=reader(kind), help=help_, **{"metavar": METAVARS.get(kind)} | more)


def add_flags(container, **helps: str):
    """Adds options without a value to the command or group. helps: their help texts, by their names."""
    for name, help_ in helps.items():
        container.add_argument(f"--{name.replace('_', '-')}", action="store_true", help=help_)


def data_of(command: Parser, container, help_: str):
    """The option --data of a command that has no dataclass of options."""
    command.former["--colmap"] = "--data"
    add_value(container, "--data", PATH, help_, metavar="DIR")


def add_some(command: Parser, cls: type, *names: str):
    """Adds the options of the dataclass with these names to the command."""
    for name in names:
        add_option(command, command, name, options_of(cls)[name], default_of(cls, name))


def add_options(command: Parser, cls: type, leave_out: tuple[str, ...] = (), **required: bool):
    """Adds the options of the dataclass to the command. required: whether an option must be given, if its
    field says otherwise."""
    command.options = cls
    options = {name: option for name, option in options_of(cls).items() if name not in leave_out}
    sizes = [option for option in options.values() if option.size]
    # Python 3.11: never an empty group
    size = command.place(sizes[0].group).add_mutually_exclusive_group() if sizes else None
    for name, option in options.items():
        container = size if size is not None and option.size else command.place(option.group)
        add_option(
            command, container, name, option, default_of(cls, name), required.get(name, option.required)
        )


def add_option(command: Parser, container, name: str, option: Option, default: Any, required: bool = False):
    """Adds one option. container: the command, or a group of it."""
    flag = f"--{option.flag or name.replace('_', '-')}"
    if option.former:
        command.former[f"--{option.former}"] = flag
    if option.kind.type is bool:
        container.add_argument(flag, dest=name, action="store_true", help=option.help).brief = option.brief
        return
    shown = option.default_help or (
        "" if default is None or required else f"{default:g}" if isinstance(default, float) else str(default)
    )
    keywords: dict[str, Any] = {
        "type": reader(option.kind),
        "default": argparse.SUPPRESS if option.steps else default,
        "required": required,
    }
    if choices := CHOICES.get(name) or option.kind.choices:
        keywords["choices"] = choices
    else:
        keywords["metavar"] = option.metavar or METAVARS.get(option.kind)
    said = f" (default: {shown})" if shown else ""
    added = container.add_argument(flag, dest=name, help=option.help + said, **keywords)
    added.brief = option.brief + said


def reader(kind: Kind) -> Callable[[str], Any]:
    """The reader of the kind, with the error type of argparse."""

    def read(word: str) -> Any:
        try:
            return kind.read(word)
        except ValueError as error:
            raise argparse.ArgumentTypeError(str(error)) from None

    return read
