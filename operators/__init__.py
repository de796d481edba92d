"""What the user can do: one file per verb. bridge.py turns Blender's data into the product's and back."""

from . import active_camera, apply, command_line, estimate, export_ply, import_colmap, import_ply, job, job_plot, job_watch, prune, prune_settings, prune_state

MODULES = (
    import_ply, import_colmap, export_ply, prune, prune_settings, estimate, job_plot, job_watch, job, apply, prune_state, active_camera, command_line,
)  # fmt: skip


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
