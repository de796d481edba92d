"""What the user can do, in rooms by topic: data, scene, jobs, io, view. Each imports only those before it."""

from importlib import import_module

from . import translation

# of each room the modules that have something to register, in this order
ROOMS = {
    "data": ("background_work", "known", "job_paths", "image_pixels", "grading", "quick_order", "materials"),
    "scene": ("dataset_paths", "place_cameras", "camera_match", "active_camera", "contribution",
        "select_gaussians", "apply_grade", "splat_transforms", "frame", "set_up_rendering", "splat_layer"),
    "jobs": ("prune", "prune_settings", "estimate", "job_pictures", "job_queue", "job_result", "job",
        "job_operators", "apply", "job_list", "orphan_jobs", "command_line", "train", "steps"),
    "io": ("import_ply", "undistort", "import_colmap", "export_ply", "export_farm", "export_levels",
        "export_page", "usd_stage"),
    "view": ("scene_cache", "view_properties", "viewport", "overlay", "render_engine", "spatial_mask",
        "select_region", "compare", "viewport_wipe", "open_image", "manual"),
}  # fmt: skip
NAMES = [f".{room}.{name}" for room, names in ROOMS.items() for name in names]
MODULES = [translation, *(import_module(name, __name__) for name in NAMES)]
