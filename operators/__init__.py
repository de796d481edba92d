"""What the user can do, in rooms by topic: data, scene, jobs, io, view. Each imports only those before it."""

from importlib import import_module

from . import registration

# all that have classes, handlers, menus, properties or timers, in the order in which they are registered
MODULES = [
    import_module(f".{name}", __name__)
    for name in (
        "translation",
        "data.background_work",
        "data.known",
        "data.job_paths",
        "data.image_pixels",
        "data.grading",
        "io.import_ply",
        "io.undistort",
        "io.import_colmap",
        "io.export_ply",
        "io.export_farm",
        "io.export_levels",
        "io.export_page",
        "io.usd_stage",
        "jobs.prune",
        "jobs.prune_settings",
        "jobs.estimate",
        "jobs.job_pictures",
        "data.quick_order",
        "jobs.job_queue",
        "jobs.job_result",
        "jobs.job_watch",
        "scene.dataset_paths",
        "jobs.job",
        "jobs.job_operators",
        "scene.place_cameras",
        "jobs.applied_jobs",
        "jobs.apply",
        "jobs.job_list",
        "jobs.orphan_jobs",
        "scene.camera_match",
        "scene.active_camera",
        "jobs.command_line",
        "view.scene_cache",
        "view.view_properties",
        "view.viewport",
        "view.overlay",
        "view.render_engine",
        "view.spatial_mask",
        "scene.contribution",
        "scene.select_gaussians",
        "view.select_region",
        "scene.apply_grade",
        "view.compare",
        "scene.splat_transforms",
        "scene.frame",
        "view.viewport_wipe",
        "view.open_image",
        "view.manual",
        "jobs.train",
        "jobs.steps",
        "data.materials",
        "scene.set_up_rendering",
        "scene.splat_layer",
    )
]


def register():
    registration.register(MODULES)


def unregister():
    registration.unregister(MODULES)
