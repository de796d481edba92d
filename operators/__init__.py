"""What the user can do: one file per operator or topic. Only bridge*.py turn Blender's data into arrays."""

from . import (
    active_camera,
    apply,
    bridge_materials,
    command_line,
    compare,
    contribution,
    estimate,
    export_ply,
    former_methods,
    import_colmap,
    import_ply,
    job,
    job_pictures,
    job_result,
    job_watch,
    overlay,
    prune,
    prune_settings,
    prune_state,
    render_engine,
    scene_cache,
    set_up_rendering,
    spatial_mask,
    splat_layer,
    view_properties,
    viewport,
)

MODULES = (
    import_ply, import_colmap, export_ply, prune, prune_settings, former_methods, estimate, job_pictures, job_result, job_watch, job, apply, prune_state,
    active_camera, command_line, scene_cache, bridge_materials, view_properties, viewport, overlay, render_engine, splat_layer, set_up_rendering,
    spatial_mask, contribution, compare,
)  # fmt: skip


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
