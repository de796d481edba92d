"""How thoroughly a splat is pruned: at once, by training on its own pictures, or by training on photographs.
Chosen in the prune panel."""

from __future__ import annotations

import bpy
from bpy.app.translations import pgettext_iface as tr

from ...svrgs_addon.finetune.methods import DEFAULT
from ..scene import dataset_paths

QUICK, TUNED, PHOTOGRAPHS = "QUICK", "TUNED", "PHOTOGRAPHS"
ITEMS = [  # the numbers are stored in .blend files
    (
        QUICK,
        "Quick",
        "Remove and merge Gaussians within seconds, by what each changes in the splat's own pictures",
        "NONE",
        1,
    ),
    (
        TUNED,
        "Fine-Tuned",
        (
            "Train what is left on pictures of the splat itself. Cameras are placed around or within it. No"
            " photographs are needed"
        ),
        "NONE",
        2,
    ),
    (
        PHOTOGRAPHS,
        "Fine-Tuned on Photographs",
        "Train what is left on the photographs of the dataset",
        "NONE",
        3,
    ),
]
NUMBERS = {number: name for name, _, _, _, number in ITEMS}


def chosen(context) -> str:
    """The choice; if none was made: photographs where there are any, else quick."""
    return NUMBERS.get(context.scene.svrgs_prune.effort_number) or (
        PHOTOGRAPHS if dataset_paths.dataset_of(context)[0] else QUICK
    )


def number_of(settings) -> int:
    """Getter of the property: the number of the choice."""
    return next(number for number, name in NUMBERS.items() if name == chosen(bpy.context))


def choose(settings, number: int):
    """Setter of the property."""
    settings.effort_number = number


def merges(context) -> bool:
    """Whether Gaussians are merged: in the quick way; and without photographs, where the method was not
    chosen and the goal is a number."""
    settings = context.scene.svrgs_prune
    if chosen(context) == TUNED:
        return settings.method == DEFAULT and settings.goal not in ("DROP", "VISIBLE", "LAMBDA")
    return chosen(context) == QUICK


def problem(context) -> str:
    """Why the chosen goal cannot be reached in the chosen way; empty if it can."""
    if chosen(context) == PHOTOGRAPHS:
        return dataset_paths.problem(context)
    if chosen(context) == QUICK and context.scene.svrgs_prune.goal == "LAMBDA":
        return tr(
            "Quick needs a number of Gaussians: choose another goal, such as a percentage, or Fine-Tuned"
        )
    return ""
