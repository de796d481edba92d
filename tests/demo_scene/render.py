"""Renders the views with Cycles on the CPU, the same bytes every time."""

from collections.abc import Callable
from pathlib import Path

import _cycles  # there once bpy has been imported, as it was by whoever built the scene
import bpy
import numpy as np
from mathutils import Matrix

from demo_scene.views import Intrinsics, Pose


def render_views(scene: bpy.types.Scene, camera: Intrinsics, poses: list[Pose], folder: Path, samples: int, progress: Callable[[int, int], None]) -> np.ndarray:
    """Write one PNG a pose into `folder`, telling `progress` how many are done. Returns the images, (V, H, W, 3) uint8 sRGB."""
    _configure_cycles(scene, samples)
    _configure_output(scene, camera)
    eye = _add_camera(scene, camera)
    images = []
    for index, pose in enumerate(poses):
        eye.matrix_world = Matrix(np.linalg.inv(pose.world_to_camera) @ np.diag([1, -1, -1, 1]))
        scene.cycles.seed = index  # else every view carries the same noise
        scene.render.filepath = str(folder / pose.name)
        bpy.ops.render.render(write_still=True)
        _strip_notes(folder / pose.name)
        images.append(_read_png(folder / pose.name))
        progress(len(images), len(poses))
    return np.stack(images)


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
    render.image_settings.file_format = "PNG"
    render.image_settings.color_mode = "RGB"
    render.image_settings.color_depth = "8"
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


def _strip_notes(path: Path) -> None:
    """Drop the chunks an image can do without: Cycles notes its render times there."""
    data = path.read_bytes()
    kept, at = data[:8], 8  # after the signature: length, type, content, checksum
    while at < len(data):
        end = at + 12 + int.from_bytes(data[at : at + 4], "big")
        if data[at + 4 : at + 8] in (b"IHDR", b"IDAT", b"IEND"):
            kept += data[at:end]
        at = end
    path.write_bytes(kept)


def _read_png(path: Path) -> np.ndarray:
    """(H, W, 3) uint8, first row on top."""
    image = bpy.data.images.load(str(path))
    width, height = image.size
    flat = np.empty(width * height * 4, dtype=np.float32)
    image.pixels.foreach_get(flat)
    bpy.data.images.remove(image)
    rgb = flat.reshape(height, width, 4)[::-1, :, :3]
    return np.rint(rgb * 255).astype(np.uint8)
