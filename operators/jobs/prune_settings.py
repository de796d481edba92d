"""Settings of the prune panel: scene.svrgs_prune, saved with the scene, and Object.svrgs_share, how much of a
result is shown."""

from __future__ import annotations

import math

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ...svrgs_addon.files.registry import USUAL
from ...svrgs_addon.prune.options import MIN_CONTRIBUTION
from ..data import splat_object, views_of_file
from ..data.devices import DEVICES
from ..data.file_kinds import KINDS
from ..data.option_properties import (
    RELATIVE,
    limited_time_property,
    method_choice_property,
    option_property,
    time_property,
)
from ..data.reporting import ReportingOperator
from ..translation import OWN
from . import efforts, goals, job_result
from .job_options import JobOptions

WEAKEST, STRONGEST = -5.0, -3.0  # ends of the slider Strength: powers of ten of λ_F


def _get_amount(settings) -> float:
    return min(1.0, max(0.0, (math.log10(settings.lambda_f) - WEAKEST) / (STRONGEST - WEAKEST)))


def _set_amount(settings, value: float):
    settings.lambda_f = 10 ** (WEAKEST + value * (STRONGEST - WEAKEST))


def _lambda_changed(settings, context):
    """Whoever sets λ_F wants it to count: a script need not set the goal."""
    if settings.goal in goals.PRESETS:
        settings.goal = "LAMBDA"


def _share_changed(obj, context):
    if job_result.undecided(obj):
        total = splat_object.count(job_result.original_of(obj) or obj)
        job_result.show(obj, round(obj.svrgs_share / 100 * total))


class SVRGS_PG_prune(JobOptions, bpy.types.PropertyGroup):
    effort: EnumProperty(
        name="Effort", items=efforts.ITEMS, get=efforts.number_of, set=efforts.choose,
        description=(
            "How thoroughly the splat is pruned. Until you choose: on photographs if the splat has"
            " some, else quick"
        ),
    )  # fmt: skip
    views: EnumProperty(
        name="Views", items=views_of_file.ITEMS, description="From where the splat's own pictures are taken"
    )
    effort_number: IntProperty(options={"HIDDEN"})  # of the item; 0: none was chosen
    device: EnumProperty(
        name="Device",
        items=[(key, device.name, device.source) for key, device in DEVICES.items()],
        description="Where the splat will be shown",
    )
    goal: EnumProperty(
        name="Goal",
        translation_context=OWN,
        items=goals.ITEMS,
        default="BALANCED",
        description="What decides how many Gaussians stay",
    )
    amount: FloatProperty(
        name="Strength", get=_get_amount, set=_set_amount, min=0, max=1, subtype="FACTOR", precision=2,
        description=(
            "How strongly Gaussians are removed. 0 is λ_F = 1e-5, the middle 1e-4, 1 is 1e-3. More"
            " keeps fewer Gaussians"
        ),
    )  # fmt: skip
    lambda_f: FloatProperty(
        name="Exact λ_F", default=1e-4, update=_lambda_changed, min=1e-7, max=1, soft_min=1e-5,
        soft_max=1e-3, precision=6,
        description="The λ_F of the goal Strength, as a number. A higher λ_F keeps fewer Gaussians",
    )  # fmt: skip
    share: FloatProperty(
        name="Keep",
        subtype="PERCENTAGE",
        min=0.1,
        max=100,
        default=25,
        description="Percentage of the Gaussians to keep",
    )
    count: IntProperty(name="Keep", min=1, default=100_000, description="Number of Gaussians to keep")
    size: FloatProperty(
        name="Size in MB",
        min=0.001,
        soft_max=500,
        default=5,
        precision=1,
        description="Size of the file that is exported, in megabytes",
    )
    size_kind: EnumProperty(name="Format", items=KINDS, default=USUAL.name, description="Format of that file")
    drop: FloatProperty(
        name="Loss in dB", min=0.01, soft_max=3, default=0.3, precision=2,
        description=(
            "PSNR in dB that may be lost, measured on some of the photographs that no step trains on."
            " At least 5 % of the Gaussians stay"
        ),
    )  # fmt: skip
    use_time: limited_time_property()
    time: time_property(default=60)
    method_choice: method_choice_property()
    iterations: option_property("iterations", soft_max=30_000)
    recovery: option_property("recovery", soft_max=30_000)
    holdout: option_property(
        "holdout", name="Hold Out Every Nth Photo",
        description=(
            "Every N-th photograph is not used for pruning: the quality is measured on it. 0: no"
            " photograph is held out"
        ),
    )  # fmt: skip
    min_contribution: option_property(
        "min_contribution", name="Drop Below", default=MIN_CONTRIBUTION, precision=3,
        description=(
            "SVR-GS methods first drop the Gaussians that cover less than this share of every pixel in"
            " every photograph"
        ),
    )  # fmt: skip
    visible_mask: option_property("visible_mask", name="Visible Part Only")
    nested: BoolProperty(
        name="Train Smaller Sizes",
        description=(
            "Also train smaller numbers of Gaussians, down to a tenth of the result, so that the slider Keep"
            " shows a good picture at every position. The result as a whole loses 0.1 to 0.5 dB"
        ),
    )
    views_by_loss: option_property("views_by_loss", name="Harder Views More Often")
    folder: StringProperty(
        name="Job Folder", subtype="DIR_PATH", options=RELATIVE,
        description=(
            "Folder for the files of jobs. Empty: svrgs_jobs next to the .blend file; for an unsaved"
            " file, the extension's own folder"
        ),
    )  # fmt: skip


class SVRGS_OT_set_lambda(ReportingOperator):
    bl_label = "Set Strength"
    bl_description = "Set λ_F to one of the values in the SVR-GS paper"

    value: FloatProperty(
        name="λ_F",
        min=1e-7,
        max=1,
        default=1e-4,
        precision=6,
        description="A higher λ_F keeps fewer Gaussians",
    )

    def work(self, context) -> str:
        context.scene.svrgs_prune.lambda_f = self.value
        return ""


PROPERTIES = {
    ("Scene", "svrgs_prune"): PointerProperty(type=SVRGS_PG_prune),
    ("Object", "svrgs_share"): FloatProperty(
        name="Keep", subtype="PERCENTAGE", min=0, max=100, update=_share_changed,
        description="Percentage of the original's Gaussians that are shown. Apply keeps them",
    ),
}  # fmt: skip
