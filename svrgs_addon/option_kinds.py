"""Kinds of options: how the command line reads one, what a job folder may hold, and which range Blender offers."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import Any

from .errors import SceneError


@dataclass(frozen=True)
class Kind:
    """type: of the value in Python; wanted: what a value must be, for messages; minimum, maximum: of Blender's property."""

    type: type
    wanted: str = ""
    good: Callable[[Any], bool] = lambda _: True
    parse: Callable[[str], Any] | None = None  # from a word; None: the type itself
    minimum: float | None = None
    maximum: float | None = None
    choices: tuple = ()

    def read(self, word: str) -> Any:
        """The value of a word. Raises ValueError with a sentence."""
        try:
            value = (self.parse or self.type)(word)
        except ValueError:
            raise ValueError(f"'{word}' is not {self.wanted}") from None
        if not self.good(value):
            raise ValueError(f"'{word}' is not {self.wanted}")
        return value

    def fits(self, value: Any) -> bool:
        """Whether a value from a file is of this kind."""
        if self.type is float:
            right = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
        elif self.type is Path:
            right = isinstance(value, str)
        else:
            right = isinstance(value, self.type) and (self.type is bool or not isinstance(value, bool))
        return right and self.good(value)


def _colour(word: str) -> tuple[float, ...]:
    return tuple(float(part) for part in word.split(","))


def _finite(low: float) -> Callable[[float], bool]:
    return lambda value: low <= value < math.inf


FLAG, TEXT, PATH = Kind(bool), Kind(str), Kind(Path)
FILE = Kind(Path, "a file that exists", lambda value: Path(value).is_file())
COUNT = Kind(int, "a whole number of 0 or more", lambda value: value >= 0, minimum=0)
POSITIVE = Kind(int, "a whole number of 1 or more", lambda value: value > 0, minimum=1)
SH_DEGREE = Kind(int, "a degree of 0 to 3", choices=(0, 1, 2, 3))
WEIGHT = Kind(float, "a weight of 0 or more", _finite(0), minimum=0)
GIGABYTES = Kind(float, "a number of gigabytes", _finite(0), minimum=0)
DECIBELS = Kind(float, "a number of dB above 0", lambda value: 0 < value < math.inf, minimum=0)
SHARE = Kind(float, "a share above 0 and up to 1", lambda value: 0 < value <= 1, minimum=0, maximum=1)
SMALL_SHARE = Kind(float, "a share of 0 or more, below 1", lambda value: 0 <= value < 1, minimum=0, maximum=0.99)
FACTOR = Kind(float, "a factor of 0.001 to 10", lambda value: 0.001 <= value <= 10, minimum=0.001, maximum=10)
COLOUR = Kind(
    tuple, "three numbers of 0..1 with commas between", lambda parts: len(parts) == 3 and all(0 <= part <= 1 for part in parts), _colour, minimum=0, maximum=1
)


@dataclass(frozen=True)
class Option:
    """The metadata of one field of a dataclass of options."""

    kind: Kind
    help: str  # after its name: what it is, without the default
    metavar: str = ""
    default_help: str = ""  # where the default is not one value
    size: bool = False  # one of those that say how many Gaussians stay: at most one may be given
    required: bool = False
    in_job: bool = False  # a job folder may hold it


def option(kind: Kind, default: Any, help_: str, **more) -> Any:
    """A field of a dataclass of options."""
    return field(default=default, metadata={"option": Option(kind, help_, **more)})


def options_of(cls: type) -> dict[str, Option]:
    """The options of a dataclass by name."""
    return {found.name: found.metadata["option"] for found in fields(cls) if "option" in found.metadata}


def default_of(cls: type, name: str) -> Any:
    """The default of one option of a dataclass."""
    return next(found.default for found in fields(cls) if found.name == name)


def check_mapping(cls: type, values: object) -> dict[str, Any]:
    """The options that a job folder holds, checked by name, type and range; paths become Path. Raises SceneError."""
    if not isinstance(values, dict):
        raise SceneError("the job has no options")
    known, checked = options_of(cls), {}
    for name, value in values.items():
        found = known.get(name)
        if found is None or not found.in_job:
            raise SceneError(f"'{str(name)[:40]}' is no option of a job")
        if not found.kind.fits(value):
            raise SceneError(f"the option '{name}' is not {found.kind.wanted or 'of the right type'}")
        if isinstance(value, str) and ("\0" in value or "\n" in value):
            raise SceneError(f"the option '{name}' holds characters that no path has")
        checked[name] = value if found.kind.type is not Path else Path(value) if value else None
    return checked
