"""The images of a forward pass: name, shape, render pass in Blender, and how each is shown as a picture."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Output:
    """One image of a view, (H, W) or (H, W, channels).

    render_pass: (name, channel letters, type) of the render pass in Blender; None: the image is no render
    pass of its own. shown: how an 8-bit picture of `svrgs render` shows the values. 'plain': 0 to 1
    unchanged. 'mask_map': with the colour map of masks. 'farthest': grey, from black at 0 to white at the
    largest value. Empty: `svrgs render` does not write it.
    """

    name: str
    channels: int = 0  # length of the last axis; 0: the image is (H, W)
    integer: bool = False  # int32 instead of the rasterizer's dtype
    differentiable: bool = False  # backward() accepts the gradient of the loss with respect to it
    render_pass: tuple[str, str, str] | None = None
    shown: str = ""


# In the order of the struct svrgs_images in native/include/svrgs.h, which defines each image.
OUTPUTS: dict[str, Output] = {
    output.name: output
    for output in (
        Output("rgb", channels=3, differentiable=True, shown="plain"),
        Output("depth", differentiable=True, render_pass=("Depth", "Z", "VALUE"), shown="farthest"),
        Output("alpha", differentiable=True, render_pass=("SplatAlpha", "A", "VALUE"), shown="plain"),
        Output("mask", differentiable=True, render_pass=("SpatialMask", "X", "VALUE"), shown="mask_map"),
        Output("hits", integer=True, render_pass=("Count", "X", "VALUE")),
        Output("kept", integer=True),
        Output("transmittance"),
    )
}
# values of `svrgs render --outputs`
PICTURES = tuple(output.name for output in OUTPUTS.values() if output.shown)
