"""What the user can do: one file per operator or topic. Only bridge*.py turn Blender's data into arrays."""

from . import (
    active_camera,
    applied_jobs,
    apply,
    command_line,
    compare,
    contribution,
    dataset_paths,
    estimate,
    export_ply,
    former_methods,
    import_colmap,
    import_ply,
    job,
    job_list,
    job_pictures,
    job_result,
    job_watch,
    orphan_jobs,
    overlay,
    prune,
    prune_settings,
    prune_state,
    render_engine,
    scene_cache,
    spatial_mask,
    view_properties,
    viewport,
)

MODULES = (
    import_ply, import_colmap, export_ply, prune, prune_settings, former_methods, estimate, job_pictures, job_result, job_watch, dataset_paths, job,
    applied_jobs, apply, job_list, orphan_jobs, prune_state, active_camera, command_line, scene_cache, view_properties, viewport, overlay, render_engine,
    spatial_mask, contribution, compare,
)  # fmt: skip


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
