"""The goals of the prune panel: what decides how many Gaussians stay, as options of a job.

Light, Balanced and Small multiply the method's default λ_F. Methods without λ_F keep a share of the
Gaussians. What the three give on four scenes: docs/figures.md, "Light, Balanced and Small".
"""

from __future__ import annotations

from typing import NamedTuple

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.finetune.methods import DEFAULT, METHODS
from ...svrgs_addon.finetune.methods.base import Method
from ...svrgs_addon.render.metrics.lpips import weights_file
from ..data import splat_object
from ..data.devices import DEVICES
from ..data.file_kinds import format_of


class Preset(NamedTuple):
    """One of the first three goals."""

    strength: float  # times the method's default λ_F
    share: float  # of the Gaussians, for methods without λ_F
    sentence: str


PRESETS = {
    "LIGHT": Preset(0.1, 0.5, "Removes only what the photographs hardly need"),
    "BALANCED": Preset(1.0, 0.25, "Much smaller, with little loss"),
    "SMALL": Preset(10.0, 0.17, "The smallest that lost at most 0.1 dB of PSNR when measured"),
}

ITEMS = [  # the numbers are stored in .blend files
    ("LIGHT", "Light", PRESETS["LIGHT"].sentence, "NONE", 5),
    ("BALANCED", "Balanced", PRESETS["BALANCED"].sentence, "NONE", 6),
    ("SMALL", "Small", PRESETS["SMALL"].sentence, "NONE", 7),
    ("SHARE", "Percentage", "Keep this percentage of the Gaussians", "NONE", 1),
    ("COUNT", "Count", "Keep this number of Gaussians", "NONE", 2),
    ("SIZE", "File Size", "Keep as many Gaussians as fit into a file of this size", "NONE", 3),
    ("DROP", "Loss", "Keep as few Gaussians as lose about this much PSNR", "NONE", 4),
    ("VISIBLE", "No Visible Change", "Keep as few Gaussians as look the same, by LPIPS", "NONE", 9),
    ("DEVICE", "Device", "Keep as many Gaussians as a device shows fluently", "NONE", 8),
    ("LAMBDA", "Strength", "λ_F decides how many Gaussians stay. A higher strength keeps fewer", "NONE", 0),
]
VISIBLE = 0.01  # of LPIPS: hardly visible


def options(settings, obj: bpy.types.Object, merges: bool = False) -> dict:
    """The goal of the panel's settings for a splat, as options of a job. merges: Gaussians are merged, to a
    number."""
    method, total, goal = METHODS[settings.method], splat_object.count(obj), settings.goal
    if goal == "DROP":
        return {"max_drop": round(settings.drop, 4)}
    if goal == "VISIBLE":
        return {"max_lpips": VISIBLE}
    if goal == "LAMBDA":
        # Blender stores 32 bits
        return {"lambda_f": float(f"{settings.lambda_f:.6g}")} if method.lambda_f else {}
    if goal == "BALANCED" and not (merges or _needs_share(method)):
        return {}
    if goal in PRESETS:
        preset = PRESETS[goal]
        if method.lambda_f and not merges:
            return {"lambda_f": method.lambda_f * preset.strength}
        return {"target_count": max(1, round(preset.share * total))}
    if goal == "SIZE":
        suffix = format_of(settings.size_kind).suffixes[0]
        return {"target_size": float(f"{settings.size:.6g}"), "target_format": suffix}
    wanted = {
        "SHARE": settings.share / 100 * total,
        "COUNT": settings.count,
        "DEVICE": DEVICES[settings.device].gaussians,
    }[goal]
    return {"target_count": min(total, max(1, round(wanted)))}


def sentence(settings, merges: bool = False) -> str:
    """What the goal means for the chosen method; empty where its property says it all. merges: as for
    options()."""
    method, goal = METHODS[settings.method], settings.goal
    preset = PRESETS.get(goal)
    if goal == "VISIBLE":
        return tr(
            "LPIPS, which sees texture and fine structure, rises by at most {most:g} in views that no step"
            " trains on"
        ).format(most=VISIBLE)
    if goal == "DEVICE":
        return tr(
            "Keeps {count:,} Gaussians, or all if there are fewer. How many a pixel blends counts as much:"
            " see Estimate"
        ).format(count=DEVICES[settings.device].gaussians)
    if merges and preset is not None:
        return _share_sentence(preset.share)
    if preset is None:
        return _own_amount(method) if goal == "LAMBDA" and not method.lambda_f else ""
    if method.name == DEFAULT:
        return tr(preset.sentence)
    if method.lambda_f:
        text = tr("{times:g} times the default λ_F of this method")
        if preset.strength == 1:
            text = tr("The default λ_F of this method")
        return text.format(times=preset.strength)
    if goal == "BALANCED" and not _needs_share(method):
        return _own_amount(method)
    return _share_sentence(preset.share)


def strength_sentence(settings) -> str:
    """The value of λ_F in words, and what it means in the chosen method; empty where it has none."""
    method = METHODS[settings.method]
    if not method.lambda_f:
        return ""
    times = settings.lambda_f / method.lambda_f
    text = tr("λ_F = {value}, 1/{times:.3g} of the default: {meaning}")
    if 0.999 < times < 1.001:
        text = tr("λ_F = {value}, the default: {meaning}")
    elif times > 1:
        text = tr("λ_F = {value}, {times:.3g} times the default: {meaning}")
    mantissa, exponent = f"{settings.lambda_f:.2e}".split("e")
    value, times = f"{float(mantissa):g}e{int(exponent)}", max(times, 1 / times)
    return text.format(value=value, times=times, meaning=tr(method.lambda_f_help))


def problem(settings) -> str:
    """Why the chosen method cannot reach the chosen goal; empty if it can."""
    method, learns = METHODS[settings.method], settings.iterations > 0
    if settings.goal == "VISIBLE" and not weights_file().is_file():
        return tr(
            "No Visible Change measures LPIPS, and its weights are missing: in a checkout of SVR-GS, make"
            " lpips fetches them"
        )
    if settings.effort == "QUICK":  # its own problems: efforts.py
        return ""
    if settings.goal == "LAMBDA" and method.ranks and not method.share:
        text = tr("'{method}' only ranks the Gaussians: choose another goal, such as a percentage or a size")
        return text.format(method=tr(method.label))
    if settings.goal == "VISIBLE" and method.learns_masks:
        text = tr("'{method}' cannot hold LPIPS: choose another goal or method")
        return text.format(method=tr(method.label))
    if settings.goal not in ("DROP", "VISIBLE") or (method.supports_max_loss and learns):
        return ""
    if learns:
        text = tr("'{method}' cannot prune to a loss in dB: choose another goal or method")
        return text.format(method=tr(method.label))
    return tr("A loss as the goal needs iterations: set more than 0")


def _own_amount(method: Method) -> str:
    """What a method without λ_F keeps if it is asked for nothing."""
    if method.share:
        return _share_sentence(method.share)
    if method.ranks:
        return ""
    return tr("The method's own weight decides") if method.lambda_m else tr("The method's own rule decides")


def _share_sentence(share: float) -> str:
    return tr("Keeps {share:.0%} of the Gaussians").format(share=share)


def _needs_share(method: Method) -> bool:
    """Whether the method has no amount of its own."""
    return method.ranks and not method.share
