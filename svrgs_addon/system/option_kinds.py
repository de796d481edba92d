"""Kinds of options, and options as fields of a dataclass.

A kind says how the command line parses an option, which values a job folder may hold, and which range Blender
offers.
"""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from .errors import SceneError
from .file_names import extended

MAX_SHOWN = 80  # characters of a word in a message


@dataclass(frozen=True)
class Kind:
    """Kind of a value.

    type: Python type of the value. wanted: description of valid values, for messages ('a number of dB above
    0'). good: whether a value of this type is valid. parse: makes the value of a word of the command line;
    None: the type does. minimum, maximum: range of Blender's property. choices: the only valid values, if
    there are any.
    """

    type: type
    wanted: str = ""
    good: Callable[[Any], bool] = lambda _: True
    parse: Callable[[str], Any] | None = None
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple = ()

    def read(self, word: str) -> Any:
        """Parses a word of the command line. Raises ValueError with one sentence if it is not valid."""
        try:
            value = (self.parse or self.type)(word)
        except ValueError:  # also a number of thousands of digits
            value = None
        if value is None or not self.good(value):
            raise ValueError(
                f"'{word if len(word) < MAX_SHOWN else word[:MAX_SHOWN] + '...'}' is not {self.wanted}"
            )
        return value

    def fits(self, value: Any) -> bool:
        """Whether a value from JSON is valid: finite numbers, bool only for flags, text for paths."""
        if self.type is float:
            right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        elif self.type is Path:
            right = isinstance(value, str)
        else:
            right = isinstance(value, self.type) and (self.type is bool or not isinstance(value, bool))
        return right and self.good(value)


def _numbers(word: str) -> tuple[float, ...]:
    """Parses numbers with commas between them."""
    return tuple(float(part) for part in word.split(","))


def _range(word: str) -> tuple[float, ...]:
    """Parses two numbers with a comma between; either may be empty: no limit there."""
    low, high = word.split(",")
    return float(low or "-inf"), float(high or "inf")


def _finite(numbers: tuple) -> bool:
    return all(math.isfinite(number) for number in numbers)


FLAG, TEXT, PATH = Kind(bool), Kind(str), Kind(Path, parse=extended)
FILE = Kind(Path, "a file that exists", lambda value: Path(value).is_file(), parse=extended)
COUNT = Kind(int, "a whole number of 0 or more", lambda value: value >= 0, minimum=0)
POSITIVE = Kind(int, "a whole number of 1 or more", lambda value: value > 0, minimum=1)
SH_DEGREE = Kind(int, "a degree of 0 to 3", choices=(0, 1, 2, 3))
DENSIFY = Kind(str, "3dgs or mcmc", lambda value: value in ("3dgs", "mcmc"), choices=("3dgs", "mcmc"))
SWITCHES = ("off", "auto", "on")
SWITCH = Kind(str, "off, auto or on", lambda value: value in SWITCHES, choices=SWITCHES)
OUTSIDES = ("auto", "ignore", "background")
OUTSIDE = Kind(str, "auto, ignore or background", lambda value: value in OUTSIDES, choices=OUTSIDES)
WEIGHT = Kind(float, "a weight of 0 to 1e9", lambda value: 0 <= value <= 1e9, minimum=0, maximum=1e9)
GIGABYTES = Kind(
    float, "a number of gigabytes of 0 to 1,000,000", lambda value: 0 <= value <= 1e6, minimum=0, maximum=1e6
)
MEGABYTES = Kind(float, "a number of MB above 0", lambda value: 0 < value < math.inf, minimum=0)
SECONDS = Kind(float, "a number of seconds above 0", lambda value: 0 < value < math.inf, minimum=0)
DECIBELS = Kind(float, "a number of dB above 0", lambda value: 0 < value < math.inf, minimum=0)
SHARE = Kind(float, "a share above 0 and up to 1", lambda value: 0 < value <= 1, minimum=0, maximum=1)
LOSS = Kind(float, "a number above 0 and below 1", lambda value: 0 < value < 1, minimum=0, maximum=1)
SMALLER_SHARE = Kind(
    float, "a share above 0 and below 1", lambda value: 0 < value < 1, minimum=0, maximum=0.99
)
SMALL_SHARE = Kind(
    float, "a share of 0 or more, below 1", lambda value: 0 <= value < 1, minimum=0, maximum=0.99
)
FACTOR = Kind(float, "a factor of 0.001 to 10", lambda value: 0.001 <= value <= 10, minimum=0.001, maximum=10)
COLOUR = Kind(
    tuple,
    "three numbers of 0..1 with commas between",
    lambda parts: len(parts) == 3 and all(0 <= part <= 1 for part in parts),
    _numbers,
    minimum=0,
    maximum=1,
)
SHARES = Kind(
    tuple,
    "shares above 0 and below 1 with commas between, each once",
    lambda parts: (
        len({f"{100 * part:g}" for part in parts}) == len(parts) and all(0 < part < 1 for part in parts)
    ),
    _numbers,
)
RANGE = Kind(
    tuple,
    "two numbers with a comma between, the lower one first; either may be left out",
    lambda ends: ends[0] <= ends[1],
    _range,
)
BOX = Kind(
    tuple, "six numbers with commas between", lambda numbers: len(numbers) == 6 and _finite(numbers), _numbers
)
POINT = ANGLES = Kind(
    tuple,
    "three numbers with commas between",
    lambda numbers: len(numbers) == 3 and _finite(numbers),
    _numbers,
)
NUMBER = Kind(float, "a number of -20 to 20", lambda value: -20 <= value <= 20)
POSITIVE_FLOAT = Kind(float, "a number above 0", lambda value: 0 < value < math.inf)
SPZ_VERSION = Kind(int, "a version from 2 to 4", choices=(2, 3, 4))
SPHERE = Kind(
    tuple,
    "four numbers with commas between, the last one 0 or more",
    lambda numbers: len(numbers) == 4 and _finite(numbers) and numbers[3] >= 0,
    _numbers,
)


@dataclass(frozen=True)
class Option:
    """Metadata of one field of a dataclass of options."""

    kind: Kind
    help: str  # help text without the default value
    group: str = ""  # heading in --help; an option without one stands under --help-all alone
    flag: str = ""  # name on the command line without its dashes, if it is not that of the field
    former: str = ""  # an older name on the command line that is still read, and not shown
    metavar: str = ""
    default_help: str = ""  # description of the default where it is not one value
    size: bool = False  # sets the number of Gaussians that stay; at most one such option may be given
    steps: bool = False  # sets the number of steps; no such option may be given with a time limit
    required: bool = False
    in_job: bool = False  # allowed in a job folder

    @property
    def brief(self) -> str:
        """The help text up to its first semicolon or colon: what --help shows."""
        return re.split("[;:]", self.help, maxsplit=1)[0]


def option(kind: Kind, default: Any, help_: str, **more) -> Any:
    """A dataclass field with its default and its Option metadata; `more` are further fields of Option."""
    return field(default=default, metadata={"option": Option(kind, help_, **more)})


def options_of(cls: type) -> dict[str, Option]:
    """The options of a dataclass as {name: Option}, in the order of its fields."""
    return {found.name: found.metadata["option"] for found in fields(cls) if "option" in found.metadata}


def default_of(cls: type, name: str) -> Any:
    """The default value of one option of a dataclass."""
    return next(found.default for found in fields(cls) if found.name == name)


def flag_of(cls: type, name: str) -> str:
    """The name of an option on the command line, with its dashes."""
    found = options_of(cls).get(name)
    return f"--{found.flag if found and found.flag else name.replace('_', '-')}"


def check_mapping(cls: type, values: object, in_job: bool = True) -> dict[str, Any]:
    """Checks options that were read from JSON by name, type and range and returns them. Texts of path options
    become Path, empty ones None, lists tuples. in_job: only options that are allowed in a job folder. Raises
    SceneError."""
    if not isinstance(values, dict):
        raise SceneError("the job has no options")
    known, checked = options_of(cls), {}
    for name, value in values.items():
        found = known.get(name)
        value = tuple(value) if isinstance(value, list) else value
        if found is None or (in_job and not found.in_job):
            raise SceneError(f"'{str(name)[:40]}' is no option of a job")
        if not found.kind.fits(value):
            raise SceneError(f"the option '{name}' is not {found.kind.wanted or 'of the right type'}")
        if isinstance(value, str) and ("\0" in value or "\n" in value):
            raise SceneError(f"the option '{name}' holds characters that no path has")
        checked[name] = value if found.kind.type is not Path else extended(str(value)) if value else None
    return checked
