"""Step 3: original and pruned splat compared, in images and figures. In the 3D View and in the Image
Editor."""

import bpy
from bpy.app.translations import pgettext_iface as tr

from ..operators.view import compare, viewport_wipe
from .sidebar import SidebarPanel, native_library_works, split_column, wrapped_label
from .spatial_mask import draw_image


def has_something(context) -> bool:
    return bool(compare.guessed(context))


def draw(layout, context):
    settings = context.scene.svrgs_view
    wiping = viewport_wipe.pair(context.scene) is not None
    if not native_library_works(layout):
        return
    column = split_column(layout)
    guessed = compare.guessed(context)
    for name in ("original", "pruned", "compare_camera"):
        column.prop(settings, name, placeholder=guessed.get(name, ""))
    column = layout.column(align=True)
    column.operator("svrgs.viewport_wipe", icon="ARROW_LEFTRIGHT", depress=wiping)
    row = column.row(align=True)
    row.operator("svrgs.compare", icon="IMAGE_ALPHA")
    row.operator("svrgs.contact_sheet", icon="RENDERLAYERS", text="All Cameras")
    image = bpy.data.images.get(compare.WIPE)
    if image is not None or wiping:
        layout.prop(settings, "wipe", slider=True)
    if image is None:
        wrapped_label(layout, tr("Renders original and pruned side by side"), "INFO")
        return
    if not wiping:
        draw_image(layout, image)
        layout.operator("svrgs.open_image", icon="WINDOW").name = compare.WIPE
    if figures := compare.figures():
        table(layout, figures)


class SVRGS_PT_compare_image(SidebarPanel):
    bl_label = "Compare"
    manual = "blender.html#compare"
    bl_space_type = "IMAGE_EDITOR"

    def draw(self, context):
        draw(self.layout, context)


def table(layout, result: dict):
    """Figures of both splats, side by side."""
    lines: list[tuple[str, ...]] = [("", tr("Original"), tr("Pruned"))]
    rows = result["original"], result["pruned"]
    lines.append((tr("Gaussians"), *(f"{row['count']:,}" for row in rows)))
    lines.append(("MB", *(f"{row['bytes'] / 1e6:.1f}" for row in rows)))
    for key, digits in (("psnr", 2), ("ssim", 4), ("lpips", 4), ("flip", 4)):
        if key in rows[0]:
            lines.append((key.upper(), *(f"{row[key]:.{digits}f}" for row in rows)))
    box = layout.box()
    text = tr("{camera}: {psnr:.1f} dB between them")
    wrapped_label(box, text.format(camera=result["camera"], psnr=result["between"]))
    grid = box.grid_flow(row_major=True, columns=3, even_columns=True, align=True)
    for line in lines:
        for text in line:
            grid.label(text=text, translate=False)
    if "hidden" in result:
        text = tr("{share:.1%} of it is masked out, and does not count")
        wrapped_label(box, text.format(share=result["hidden"]))
    if "lpips_missing" in result:
        wrapped_label(box, result["lpips_missing"], "ERROR")
