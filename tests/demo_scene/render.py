"""Renders the views with Cycles on the CPU, the same bytes every time."""

from collections.abc import Callable
from pathlib import Path

import _cycles  # there once bpy has been imported, as it was by whoever built the scene
import bpy
import numpy as np
from mathutils import Matrix

from demo_scene import png
from demo_scene.views import Intrinsics, Pose

Develop = Callable[[int, np.ndarray], np.ndarray]  # a view's number and linear light to (H, W, 3) uint8 sRGB


def render_views(
    scene: bpy.types.Scene,
    camera: Intrinsics,
    poses: list[Pose],
    folder: Path,
    samples: int,
    progress: Callable[[int, int], None],
    develop: Develop | None = None,
) -> np.ndarray:
    """Write one PNG a pose into `folder`, telling `progress` how many are done. Returns the images, (V, H, W,
    3) uint8 sRGB.

    Without `develop`, Blender makes the pictures from the light.
    """
    _configure_cycles(scene, samples)
    _configure_output(scene, camera)
    eye = _add_camera(scene, camera)
    images = []
    for index, pose in enumerate(poses):
        eye.matrix_world = Matrix(np.linalg.inv(pose.world_to_camera) @ np.diag([1, -1, -1, 1]))
        scene.cycles.seed = index  # else every view carries the same noise
        path = folder / pose.name
        if develop is None:
            _render(scene, "PNG", path)
            path.write_bytes(png.without_notes(path.read_bytes()))
            images.append(np.rint(_read(path) * 255).astype(np.uint8))
        else:
            light = path.with_suffix(".exr")
            _render(scene, "OPEN_EXR", light)
            images.append(develop(index, _read(light)))
            light.unlink()
            png.write(path, images[-1])
        progress(len(images), len(poses))
    return np.stack(images)


def _render(scene: bpy.types.Scene, file_format: str, path: Path) -> None:
    scene.render.image_settings.file_format = file_format
    scene.render.image_settings.color_mode = "RGB"
    scene.render.image_settings.color_depth = "8" if file_format == "PNG" else "32"
    scene.render.filepath = str(path)
    bpy.ops.render.render(write_still=True)


def _configure_cycles(scene: bpy.types.Scene, samples: int) -> None:
    scene.render.engine = "CYCLES"
    scene.render.use_persistent_data = True
    cycles = scene.cycles
    cycles.device = "CPU"
    cycles.samples = samples
    cycles.use_adaptive_sampling = False
    cycles.use_light_tree = False  # there are two lamps to choose from
    cycles.use_denoising = _cycles.with_openimagedenoise  # some distributions' Blenders lack it
    cycles.denoising_prefilter = "FAST"
    cycles.max_bounces = 3
    cycles.diffuse_bounces = 2
    cycles.glossy_bounces = 2
    cycles.use_fast_gi = True  # after one bounce, occlusion stands in for the rest
    cycles.ao_bounces_render = 1
    cycles.sample_clamp_indirect = 4.0
    cycles.caustics_reflective = cycles.caustics_refractive = False


def _configure_output(scene: bpy.types.Scene, camera: Intrinsics) -> None:
    render = scene.render
    render.resolution_x, render.resolution_y = camera.width, camera.height
    render.resolution_percentage = 100
    render.dither_intensity = 0
    scene.display_settings.display_device = "sRGB"
    scene.view_settings.view_transform = "Standard"
    scene.view_settings.look = "None"


def _add_camera(scene: bpy.types.Scene, camera: Intrinsics) -> bpy.types.Object:
    data = bpy.data.cameras.new("camera")
    data.sensor_fit = "HORIZONTAL"
    data.lens = camera.focal * data.sensor_width / camera.width
    data.clip_end = 1000
    scene.camera = bpy.data.objects.new("camera", data)
    scene.collection.objects.link(scene.camera)
    return scene.camera


def _read(path: Path) -> np.ndarray:
    """(H, W, 3) float32, first row on top: the values of the file, 0..1 in a PNG."""
    image = bpy.data.images.load(str(path))
    width, height = image.size
    flat = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(flat)
    bpy.data.images.remove(image)
    return flat.reshape(height, width, 4)[::-1, :, :3]
