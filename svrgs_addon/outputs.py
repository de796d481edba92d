"""The images that one forward pass can give: their names, shapes, render passes, and how each is shown as a picture."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Output:
    """One image of a view, (height, width) or (height, width, channels).

    render_pass: (name, channel letters, kind) of the pass in Blender, for images that become a pass of their own. shown: how an
    8-bit picture shows it. 'plain': 0 to 1 as they are; 'mask_map': in the colours of the mask map; 'farthest': from 0, black, to
    the largest value, white.
    """

    name: str
    channels: int = 0  # of a trailing axis; 0: there is none
    integer: bool = False  # int32 instead of the rasterizer's real type
    differentiable: bool = False  # a loss may have a gradient with respect to it
    render_pass: tuple[str, str, str] | None = None
    shown: str = "plain"


# In the order of svrgs_images (native/include/svrgs.h), which says what each image is.
OUTPUTS: dict[str, Output] = {
    output.name: output
    for output in (
        Output("rgb", channels=3, differentiable=True),
        Output("depth", differentiable=True, render_pass=("Depth", "Z", "VALUE"), shown="farthest"),
        Output("alpha", differentiable=True, render_pass=("Alpha", "A", "VALUE")),
        Output("mask", differentiable=True, render_pass=("SpatialMask", "X", "VALUE"), shown="mask_map"),
        Output("hits", integer=True, render_pass=("Count", "X", "VALUE")),
        Output("kept", integer=True),
        Output("transmittance"),
    )
}
