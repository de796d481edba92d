"""Step 4: export of the active splat, with the number of Gaussians and the size of the file."""

from bpy.app.translations import pgettext_iface as tr

from ..operators.data.splat_object import is_splat
from ..operators.data.splat_size import of_its_file
from ..operators.data.visible_splats import marked_count
from ..operators.io import export_farm, export_levels
from ..operators.jobs.prune_state import size
from .sidebar import wrapped_label


def has_something(context) -> bool:
    return is_splat(context.object)


def draw(layout, context):
    obj = context.object
    if not is_splat(obj):
        layout.label(text="Select the splat to export", icon="INFO")
        return
    wrapped_label(layout, tr("{name}: {size} as PLY").format(name=obj.name, size=size(obj)))
    wrapped_label(layout, of_its_file(obj))
    if marked := marked_count(obj):
        text = tr("{count:,} hidden Gaussians stay out of the file")
        wrapped_label(layout, text.format(count=marked), "INFO")
    layout.operator("svrgs.export_ply", icon="EXPORT")
    layout.operator("svrgs.export_levels", icon="MOD_DECIM")
    layout.operator("svrgs.export_page", icon="WORLD")
    layout.operator("svrgs.export_farm_job", icon="NETWORK_DRIVE")
    for line in (*export_levels.lines(), *export_farm.lines()):
        wrapped_label(layout, line)
