"""Run time and image error for several values of each constant that trades time for error ("knob")."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from svrgs_addon.native import library
from svrgs_addon.system.errors import NativeError

from . import variants
from .cases import Case
from .child import Child
from .timing import WARMUPS, ratio

STANDARD = {"level": None}  # request for the standard build


@dataclass(frozen=True)
class Setting:
    """One value of one knob: a SIMD level, which is chosen at run time, or a macro, which needs a build of
    its own."""

    knob: str
    value: str
    default: bool = False
    level: str | None = None  # None: the best level
    macro: str = ""  # NAME=VALUE; empty: the standard build

    @property
    def request(self) -> dict:
        return {"level": self.level}


# Knobs that need a build: knob -> (macro, {value of the knob: value of the macro; '' for the standard
# build}).
BUILD_KNOBS = {
    "exp_degree": ("SVRGS_EXP_DEGREE", {"3": "3", "4": "4", "5": ""}),
    "alpha_cut": (
        "SVRGS_ALPHA_CUT",
        {f"{n:g}/255": f"{n / 255:.12g}" if n != 1 else "" for n in (0.5, 1, 2, 4)},
    ),
    "stop": ("SVRGS_STOP", {"1e-2": "1e-2", "1e-3": "1e-3", "1e-4": "", "1e-5": "1e-5"}),
    "tile": ("SVRGS_TILE", {"8": "8", "16": "16", "32": ""}),
    "block": ("SVRGS_BLOCK_WIDTH", {"4x4": "", "8x2": "8", "16x1": "16"}),
}


def settings() -> list[Setting]:
    """All values of all knobs, including the standard ones."""
    best = library.best_level()
    levels = [level for level in library.supported_levels() if level != "float64"]
    found = [Setting("simd", level, level == best, level=level) for level in levels]
    for knob, (name, values) in BUILD_KNOBS.items():
        for value, text in values.items():
            found.append(Setting(knob, value, not text, macro=text and f"{name}={text}"))
    return found


def measure_knobs(
    case: Case, repeat: int, progress: Callable[[str], None], chosen: list[Setting] | None = None
) -> list[dict]:
    """The entry `knobs` of the result, measured on a generated room: one item per setting that can be
    measured on this machine.

    progress: called with what is measured, and with the reason why a setting is left out.
    """
    chosen = settings() if chosen is None else chosen
    missing = variants.missing_tools()
    if missing:
        progress(f"knobs that need another build of the library are left out: {missing}")
        chosen = [setting for setting in chosen if setting.knob not in BUILD_KNOBS]
    with tempfile.TemporaryDirectory(prefix="svrgs-bench-") as name, Child(case) as standard:
        bench = _Bench(case, Path(name), standard, repeat)
        entries = []
        for setting in chosen:
            progress(f"knob {setting.knob} = {setting.value}")
            try:
                entries.append(bench.entry(setting))
            except NativeError as error:
                progress(f"left out: {error}")
        return entries


class _Bench:
    """The standard build, its forward time, and the reference picture of the float64 level."""

    def __init__(self, case: Case, folder: Path, standard: Child, repeat: int):
        self.case, self.folder, self.standard, self.repeat = case, folder, standard, repeat
        self.truth = standard.image(folder, level="float64")
        readings = [standard.ask(**STANDARD) for _ in range(WARMUPS + repeat)][WARMUPS:]
        self.forward_ms = 1e3 * float(np.median([reading["forward"] for reading in readings]))

    def entry(self, setting: Setting) -> dict:
        """The figures of one setting. Raises NativeError if its build fails."""
        if setting.macro:
            built = variants.build(setting.macro, self.folder)
            with Child(self.case, built) as child:
                return self._compared(setting, child)
        return self._compared(setting, self.standard)

    def _compared(self, setting: Setting, child: Child) -> dict:
        """The figures of a setting. Both builds are measured in turn, so that a slow machine slows both."""
        difference = np.abs(child.image(self.folder, **setting.request) - self.truth)
        forward, step = (1.0, 1.0) if setting.default else self._ratios(setting, child)
        return {
            "knob": setting.knob,
            "value": setting.value,
            "default": setting.default,
            "forward_ms": self.forward_ms * forward,
            "ratio": forward,
            "step_ratio": step,
            "image_max": float(difference.max()),
            "image_mean": float(difference.mean()),
        }

    def _ratios(self, setting: Setting, child: Child) -> tuple[float, float]:
        both = lambda: (child.ask(**setting.request), self.standard.ask(**STANDARD))
        ours, plain = zip(*[both() for _ in range(WARMUPS + self.repeat)][WARMUPS:], strict=True)
        forward, step = (([a[name] for a in ours], [b[name] for b in plain]) for name in ("forward", "step"))
        return ratio(*forward), ratio(*step)
