"""What the user can do, in rooms by topic: data, scene, jobs, io, view. Each imports only those before it."""

from . import registration, translation
from .data import background_work, image_pixels, job_paths, known, materials, quick_order
from .io import export_farm, export_levels, export_ply, import_colmap, import_ply, undistort, usd_stage
from .jobs import (
    applied_jobs,
    apply,
    command_line,
    estimate,
    job,
    job_list,
    job_operators,
    job_pictures,
    job_queue,
    job_result,
    job_watch,
    orphan_jobs,
    prune,
    prune_settings,
    train,
)
from .scene import (
    active_camera,
    camera_match,
    contribution,
    dataset_paths,
    frame,
    place_cameras,
    select_gaussians,
    set_up_rendering,
    splat_layer,
    splat_transforms,
)
from .view import (
    compare,
    open_image,
    overlay,
    render_engine,
    scene_cache,
    spatial_mask,
    view_properties,
    viewport,
    viewport_wipe,
)

MODULES = (
    translation,
    background_work,
    known,
    job_paths,
    image_pixels,
    import_ply,
    undistort,
    import_colmap,
    export_ply,
    export_farm,
    export_levels,
    usd_stage,
    prune,
    prune_settings,
    estimate,
    job_pictures,
    quick_order,
    job_queue,
    job_result,
    job_watch,
    dataset_paths,
    job,
    job_operators,
    place_cameras,
    applied_jobs,
    apply,
    job_list,
    orphan_jobs,
    camera_match,
    active_camera,
    command_line,
    scene_cache,
    view_properties,
    viewport,
    overlay,
    render_engine,
    spatial_mask,
    contribution,
    select_gaussians,
    compare,
    splat_transforms,
    frame,
    viewport_wipe,
    open_image,
    train,
    materials,
    set_up_rendering,
    splat_layer,
)


def register():
    registration.register(MODULES)


def unregister():
    registration.unregister(MODULES)
