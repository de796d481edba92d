"""Step 1, for cameras without a splat: train one from their photographs; and the progress of that."""

from ..operators.jobs import train
from .jobs import draw_job
from .sidebar import split_column, wrapped_label

has_something = train.is_shown


def draw(layout, context):
    settings = context.scene.svrgs_train
    if (found := train.current_job(context)) is not None:
        draw_job(layout, context, *found)
        return
    if not train.is_shown(context):
        wrapped_label(layout, train.problem(context), "INFO")
        return
    wrapped_label(layout, train.about(context), "OUTLINER_OB_CAMERA")
    column = split_column(layout)
    column.prop(settings, "use_time")
    column.prop(settings, "time" if settings.use_time else "iterations")
    column.operator("svrgs.train", icon="PLAY", text="Train Splat from Photographs")
    if problem := train.problem(context):
        wrapped_label(layout, problem, "INFO")
