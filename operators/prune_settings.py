"""What the panel remembers: the settings of pruning with the scene, how much of a result is shown with its splat."""

from __future__ import annotations

import math

import bpy
from bpy.props import BoolProperty, EnumProperty, FloatProperty, IntProperty, PointerProperty, StringProperty

from ..svrgs_addon.cli.arguments import MIN_CONTRIBUTION, PRUNE_ITERATIONS, RECOVERY
from ..svrgs_addon.finetune.methods import METHODS
from ..svrgs_addon.finetune.methods.base import Method
from . import bridge, job_result

GOALS = [
    ("LAMBDA", "Strength λ_F", "Remove what the spatial mask finds superfluous; λ_F says how strictly"),
    ("SHARE", "Percentage", "Keep this share of the Gaussians"),
    ("COUNT", "Count", "Keep this many Gaussians"),
    ("SIZE", "Size", "Keep as many Gaussians as fit into a file of this size"),
    ("DROP", "Loss", "Remove as much as loses about so many dB in the end"),
]


def _about(method: Method) -> str:
    """What a method does, for its tooltip."""
    share = f"; keeps {method.share:.0%} unless a goal is set" if method.share else ""
    if method.ranks:
        return f"Ranks the Gaussians once{share or '; needs a percentage, a count or a size'}"
    return f"Learns what can go{', by the spatial mask' if method.lambda_f else ''}{share}"


PRUNING = [(name, name, _about(method)) for name, method in METHODS.items() if method.prunes]


def _get_lambda(settings) -> float:
    return 10**settings.strength


def _set_lambda(settings, value: float):
    settings.strength = math.log10(value)


def _share_changed(obj, context):
    if job_result.undecided(obj):
        job_result.show(obj, round(obj.svrgs_share / 100 * bridge.count(job_result.original_of(obj) or obj)))


class SVRGS_PG_prune(bpy.types.PropertyGroup):
    colmap: StringProperty(
        name="Dataset", subtype="DIR_PATH", description="COLMAP dataset of the photographs the splat was trained on. Empty: that of the imported cameras"
    )
    images: StringProperty(name="Images", description="Name of the image folder in the dataset, such as images_4. Empty: images")
    goal: EnumProperty(name="Goal", items=GOALS, description="What decides how much goes")
    strength: FloatProperty(
        name="λ_F", min=-7, max=0, soft_min=-5, soft_max=-3, default=-4, step=5, precision=2, description="Weight of the spatial mask, as power of ten"
    )
    lambda_f: FloatProperty(
        name="λ_F", get=_get_lambda, set=_set_lambda, min=1e-7, max=1, soft_min=1e-5, soft_max=1e-3, precision=6, description="Weight of the spatial mask"
    )
    share: FloatProperty(name="Keep", subtype="PERCENTAGE", min=0.1, max=100, default=25, description="Share of the Gaussians to keep")
    count: IntProperty(name="Keep", min=1, default=100_000, description="Number of Gaussians to keep")
    size: FloatProperty(name="Size in MB", min=0.001, soft_max=500, default=20, precision=1, description="Size of the pruned file, in megabytes")
    drop: FloatProperty(name="Loss in dB", min=0.01, soft_max=3, default=0.3, precision=2, description="PSNR that may be lost, on a few of the photographs")
    method: EnumProperty(name="Method", items=PRUNING, description="How it is found out what can go")
    iterations: IntProperty(name="Iterations", min=0, soft_max=30_000, default=PRUNE_ITERATIONS, description="Steps in which it is learned what can go")
    recovery: IntProperty(name="Recovery", min=0, soft_max=30_000, default=RECOVERY, description="Steps after it, to win the quality back")
    seed: IntProperty(name="Seed", min=0, description="The same seed gives the same result")
    holdout: IntProperty(name="Test Every", min=0, default=8, description="Every so many photographs one is kept for measuring. 0: none")
    min_contribution: FloatProperty(
        name="First Cut",
        min=0,
        max=0.99,
        default=MIN_CONTRIBUTION,
        precision=3,
        description="First drop what never covers this much of a pixel in any photograph",
    )
    visible_mask: BoolProperty(name="Visible Part Only", description="Count along a ray only what is seen, instead of all Gaussians to its end")
    views_by_loss: BoolProperty(name="Harder Views More Often", description="Look at the photographs that are matched best only every other time")
    folder: StringProperty(
        name="Job Folder", subtype="DIR_PATH", description="Where jobs keep their files. Empty: svrgs_jobs beside the file, or the extension's folder"
    )


def register():
    bpy.utils.register_class(SVRGS_PG_prune)
    bpy.types.Scene.svrgs_prune = PointerProperty(type=SVRGS_PG_prune)
    bpy.types.Object.svrgs_share = FloatProperty(
        name="Keep", subtype="PERCENTAGE", min=0, max=100, update=_share_changed,
        description="Share of the original's Gaussians that is shown, and that Apply keeps",
    )  # fmt: skip


def unregister():
    del bpy.types.Object.svrgs_share
    del bpy.types.Scene.svrgs_prune
    bpy.utils.unregister_class(SVRGS_PG_prune)
