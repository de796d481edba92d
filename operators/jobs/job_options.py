"""Options of `svrgs prune` that the panel and the operator for scripts have in common."""

from __future__ import annotations

from bpy.props import EnumProperty

from ..data.option_properties import method_property, option_property, sh_degree_property
from ..scene import photographs


def _masks_changed(_, context):
    """The mask over the photograph that is looked at is another one."""
    photographs.show_mask(context.scene.svrgs_view, context)


class JobOptions:
    """Base class of the settings and of the operator."""

    data: option_property(
        "data",
        name="Dataset",
        description=(
            "Dataset: photographs, and a COLMAP model or transforms.json. Empty: the dataset of the imported"
            " cameras"
        ),
    )
    images: option_property("images")
    masks: option_property("masks", update=_masks_changed)
    invert_masks: option_property("invert_masks", update=_masks_changed)
    outside: EnumProperty(
        update=_masks_changed,
        name="Masked Out",
        items=[
            ("auto", "Automatic", "What masks hide counts nowhere; what is transparent is painted black"),
            ("ignore", "Ignored", "What masks hide, and what is transparent, counts nowhere"),
            (
                "background",
                "Painted",
                "What masks hide is painted black, and so is what is transparent: an object on a turntable is"
                " then alone in the scene",
            ),
        ],
        description="What is done with the parts of photographs that do not count",
    )
    exposure: EnumProperty(
        name="Exposure",
        items=[
            ("off", "As It Is", "All photographs are taken to have the same exposure"),
            (
                "auto",
                "Where It Varies",
                "The photographs are compared with the splat first. A training has none, and fits nothing",
            ),
            ("on", "Fitted", "Each photograph has a colour matrix of its own"),
        ],
        default="auto",
        description=(
            "Whether exposure and white balance of each photograph are fitted. They are written beside the"
            " result, which keeps its colours"
        ),
    )
    refine_poses: EnumProperty(
        name="Poses",
        items=[
            ("off", "As They Are", "The cameras stay where they are"),
            (
                "auto",
                "Where They Are Off",
                "The photographs are compared with the splat first. A training has none, and moves nothing",
            ),
            ("on", "Refined", "The cameras move to where the splat shows their photographs"),
        ],
        default="auto",
        description=(
            "Whether the cameras of the photographs move while the splat is trained. They are written beside"
            " the result"
        ),
    )
    mask_distractors: option_property("mask_distractors")
    method: method_property()
    sh_degree: sh_degree_property()
    seed: option_property("seed")
    force: option_property("force")
