"""What the user can do: one file per operator or topic. Only bridge*.py turn Blender's data into arrays."""

from . import (
    active_camera,
    apply,
    bridge_materials,
    camera_match,
    command_line,
    compare,
    contribution,
    estimate,
    export_ply,
    former_methods,
    frame,
    import_colmap,
    import_ply,
    job,
    job_pictures,
    job_result,
    job_watch,
    open_image,
    overlay,
    prune,
    prune_settings,
    prune_state,
    render_engine,
    saved_images,
    scene_cache,
    set_up_rendering,
    spatial_mask,
    splat_layer,
    splat_transforms,
    train,
    view_properties,
    viewport,
    viewport_wipe,
)

MODULES = (
    import_ply,
    import_colmap,
    export_ply,
    prune,
    prune_settings,
    former_methods,
    estimate,
    job_pictures,
    job_result,
    job_watch,
    job,
    apply,
    camera_match,
    prune_state,
    active_camera,
    command_line,
    scene_cache,
    view_properties,
    viewport,
    overlay,
    render_engine,
    spatial_mask,
    contribution,
    compare,
    splat_transforms,
    saved_images,
    frame,
    viewport_wipe,
    open_image,
    train,
    bridge_materials,
    set_up_rendering,
    splat_layer,
)


def register():
    for module in MODULES:
        module.register()


def unregister():
    for module in reversed(MODULES):
        module.unregister()
