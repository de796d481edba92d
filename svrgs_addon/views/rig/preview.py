"""A picture of a rig: the scene from afar, and each camera as a small pyramid, the picture being its base."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from ...files.images import to_bytes
from ...native.rasterizer import Rasterizer, RenderOptions
from ...scene.camera import Camera
from ...scene.gaussians import Scene
from .place import Rig
from .viewpoints import View

SIDE_PIXELS = 900
# from the middle, world y down; tangent of half the angle of view
DIRECTION, TANGENT = np.array([0.6, -0.55, 0.6]), 0.4
FARTHER = 1.15  # of the distance at which all cameras fit into the picture
LENGTH = 0.07  # of a pyramid, in the largest distance of a camera from the middle
SHOWN = 3.0  # radius of what is shown of a scene that is seen from within, in the same
POINTS = 48  # drawn of each edge
COLORS = {"rig": (255, 160, 30), "held_out": (70, 150, 255)}
EDGES = ((0, 1), (0, 2), (0, 3), (0, 4), (1, 2), (2, 3), (3, 4), (4, 1))  # of a pyramid; 0 is its tip


def preview(scene: Scene, rig: Rig) -> np.ndarray:
    """The picture, (SIDE_PIXELS, SIDE_PIXELS, 3) uint8: cameras in orange, those held out in blue. Of a scene
    that is seen from within, what is nearer than the cameras is left out, and what is far away."""
    eyes = np.array([camera.position for camera in (*rig.cameras, *rig.held_out)])
    middle = np.median(eyes, axis=0)
    reach = float(np.linalg.norm(eyes - middle, axis=1).max()) or 1.0
    distance = FARTHER * reach * np.sqrt(1 + TANGENT**-2)
    eye = middle + distance * DIRECTION / np.linalg.norm(DIRECTION)
    camera = View(eye, middle, TANGENT, rig.cameras[0].unit).camera(SIDE_PIXELS)
    if rig.inside_out:
        scene = _cut_open(scene, camera, middle, reach)
    options = RenderOptions(antialiased=scene.antialiased, picture_only=True)
    images = Rasterizer().forward(scene, camera, options, outputs=("rgb", "depth", "alpha"))
    picture = to_bytes(images["rgb"])
    walls = np.where((images["alpha"] > 0.5) & (not rig.inside_out), images["depth"], np.inf)
    for name, cameras in (("rig", rig.cameras), ("held_out", rig.held_out)):
        _draw(picture, walls, camera, cameras, LENGTH * reach, COLORS[name])
    return picture


def _cut_open(scene: Scene, camera: Camera, middle: np.ndarray, reach: float) -> Scene:
    """The scene without what is nearer to the camera than the rig's middle (3,), or beyond its reach."""
    depths = scene.means @ camera.viewmat[2, :3].astype(np.float32) + np.float32(camera.viewmat[2, 3])
    near = np.linalg.norm(scene.means - middle.astype(np.float32), axis=1) < SHOWN * reach
    return scene.select(near & (depths > np.linalg.norm(camera.position - middle)))


def _draw(
    picture: np.ndarray,
    walls: np.ndarray,
    camera: Camera,
    cameras: Sequence[Camera],
    length: float,
    color: tuple[int, int, int],
):
    """Draws the pyramids where nothing is in front. walls: (H, W), depth up to which a pixel shows them."""
    points = np.concatenate([_pyramid(each, length) for each in cameras]) if cameras else np.empty((0, 3))
    local = camera.local(points)
    local = local[local[:, 2] > 0]
    x, y = camera.pixels(local).astype(np.int64).T
    inside = (x >= 0) & (x < camera.width - 1) & (y >= 0) & (y < camera.height - 1)
    x, y, z = x[inside], y[inside], local[inside, 2]
    x, y = x[z < walls[y, x]], y[z < walls[y, x]]
    for right, below in ((0, 0), (1, 0), (0, 1), (1, 1)):  # lines of two pixels
        picture[y + below, x + right] = color


def _pyramid(camera: Camera, length: float) -> np.ndarray:
    """Points on the edges of a camera's pyramid, (8 POINTS, 3), world."""
    corners = (
        np.array([(0, 0, 1), (camera.width, 0, 1), (camera.width, camera.height, 1), (0, camera.height, 1)])
        @ np.linalg.inv(camera.K).T
    )
    base = corners / np.linalg.norm(corners, axis=1, keepdims=True) * length
    nodes = np.concatenate([np.zeros((1, 3)), base]) @ camera.viewmat[:3, :3] + camera.position
    along = np.linspace(0, 1, POINTS)[:, None]
    return np.concatenate([nodes[a] + along * (nodes[b] - nodes[a]) for a, b in EDGES])
