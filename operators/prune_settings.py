"""Settings of the prune panel: scene.svrgs_prune, saved with the scene, and Object.svrgs_share, how much of a result is shown."""

from __future__ import annotations

import math

import bpy
from bpy.props import EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..svrgs_addon.jobs.options import MIN_CONTRIBUTION
from . import bridge, former_methods, job_result
from .option_properties import RELATIVE_PATH, method_property, option_property

GOALS = [
    ("LAMBDA", "Strength λ_F", "λ_F decides how many Gaussians stay. A higher λ_F keeps fewer"),
    ("SHARE", "Percentage", "Keep this percentage of the Gaussians"),
    ("COUNT", "Count", "Keep this number of Gaussians"),
    ("SIZE", "Size", "Keep as many Gaussians as fit into a file of this size"),
    ("DROP", "Loss", "Keep as few Gaussians as lose about this much PSNR"),
]


def _get_lambda(settings) -> float:
    return 10**settings.strength


def _set_lambda(settings, value: float):
    settings.strength = math.log10(value)


def _share_changed(obj, context):
    if job_result.undecided(obj):
        job_result.show(obj, round(obj.svrgs_share / 100 * bridge.count(job_result.original_of(obj) or obj)))


class SVRGS_PG_prune(bpy.types.PropertyGroup):
    colmap: option_property("colmap", name="Dataset", description="COLMAP dataset: photographs and model. Empty: the dataset of the imported cameras")
    images: option_property("images")
    goal: EnumProperty(name="Goal", items=GOALS, description="What decides how many Gaussians stay")
    strength: FloatProperty(
        name="λ_F", min=-7, max=0, soft_min=-5, soft_max=-3, default=-4, step=5, precision=2,
        description="λ_F as a power of ten: -4 is 1e-4. A higher λ_F keeps fewer Gaussians",
    )  # fmt: skip
    lambda_f: FloatProperty(
        name="λ_F", get=_get_lambda, set=_set_lambda, min=1e-7, max=1, soft_min=1e-5, soft_max=1e-3, precision=6,
        description="Strength of pruning. A higher λ_F keeps fewer Gaussians",
    )  # fmt: skip
    share: FloatProperty(name="Keep", subtype="PERCENTAGE", min=0.1, max=100, default=25, description="Percentage of the Gaussians to keep")
    count: IntProperty(name="Keep", min=1, default=100_000, description="Number of Gaussians to keep")
    size: FloatProperty(name="Size in MB", min=0.001, soft_max=500, default=20, precision=1, description="Size of the pruned file in megabytes")
    drop: FloatProperty(
        name="Loss in dB", min=0.01, soft_max=3, default=0.3, precision=2, description="PSNR in dB that may be lost, measured on a few of the photographs"
    )
    method: method_property(update=former_methods.method_chosen)
    iterations: option_property("iterations", soft_max=30_000)
    recovery: option_property("recovery", soft_max=30_000)
    seed: option_property("seed")
    holdout: option_property("holdout", name="Test Every")
    min_contribution: option_property("min_contribution", name="First Cut", default=MIN_CONTRIBUTION, precision=3)
    visible_mask: option_property("visible_mask", name="Visible Part Only")
    views_by_loss: option_property("views_by_loss", name="Harder Views More Often")
    folder: StringProperty(
        name="Job Folder", subtype="DIR_PATH", **RELATIVE_PATH,
        description="Folder for the files of jobs. Empty: svrgs_jobs next to the .blend file; for an unsaved file, the extension's own folder",
    )  # fmt: skip
    method_schema: IntProperty(options={"HIDDEN"})  # former_methods.py


def register():
    bpy.utils.register_class(SVRGS_PG_prune)
    bpy.types.Scene.svrgs_prune = PointerProperty(type=SVRGS_PG_prune)
    bpy.types.Object.svrgs_share = FloatProperty(
        name="Keep", subtype="PERCENTAGE", min=0, max=100, update=_share_changed,
        description="Percentage of the original's Gaussians that are shown. Apply keeps them",
    )  # fmt: skip


def unregister():
    del bpy.types.Object.svrgs_share
    del bpy.types.Scene.svrgs_prune
    bpy.utils.unregister_class(SVRGS_PG_prune)
