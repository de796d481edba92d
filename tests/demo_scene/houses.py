"""Houses as they are seen from afar."""

import bpy
import numpy as np

from demo_scene import materials as mat
from demo_scene.shapes import add, again, block, gable, mould, moved

WALLS = [
    [(0.42, 0.15, 0.09), (0.58, 0.28, 0.18), (0.62, 0.58, 0.52)],
    [(0.75, 0.66, 0.48), (0.82, 0.74, 0.58), (0.60, 0.52, 0.40)],
    [(0.50, 0.55, 0.58), (0.66, 0.69, 0.70), (0.40, 0.42, 0.45)],
    [(0.62, 0.36, 0.22), (0.72, 0.48, 0.30), (0.70, 0.62, 0.50)],
]


def row_of_houses(seed: int, places: list[tuple[float, float, float, float]]) -> None:
    """Houses at (x, y, z, degrees); their fronts look along -y before they are turned."""
    rng = np.random.default_rng(seed)
    pane = mat.patterned("Noise", [(0.02, 0.03, 0.05), (0.25, 0.32, 0.40)], roughness=0.1, Scale=1.5)
    frame = mat.weathered(mat.plain((0.80, 0.78, 0.72)), 0.7)
    tiles = mat.weathered(
        mat.bricks([(0.30, 0.09, 0.05), (0.48, 0.20, 0.12), (0.12, 0.05, 0.04)], Scale=1.6), 0.5, 1
    )
    for index, (x, y, z, degrees) in enumerate(places):
        wall = mat.weathered(mat.bricks(WALLS[index % len(WALLS)], Scale=1.2), 0.6, 0.7)
        width, height = rng.uniform((8, 5.2), (12, 7.5))
        moved(_house(width, 7.0, height, wall, tiles, pane, frame), (x, y, z), degrees)


def _house(width: float, depth: float, height: float, wall, tiles, pane, frame) -> list[bpy.types.Object]:
    # Bricks lie in the xy plane of their object: the walls are modelled on their back and stood up.
    body = [add("wall", block(width, height, depth), wall, (0, depth / 2, height / 2), turn=(90, 0, 0))]
    roof = add("roof", gable(width + 0.6, depth + 0.9, 3.2), tiles, (0, 0, height))
    chimney = add("chimney", block(0.7, 0.7, 2.2), wall, (0.3 * width, 1.0, height + 1.6))
    door = add(
        "door",
        block(1.1, 0.16, 2.1),
        mat.weathered(mat.plain((0.05, 0.16, 0.14))),
        (0.08 * width, -depth / 2, 0),
    )
    glass, border = mould("pane", block(0.95, 0.22, 1.3), pane), mould("frame", block(1.2, 0.14, 1.55), frame)
    things = [*body, roof, chimney, door]
    columns = int(width // 2.1)
    for floor in range(2):
        for k in range(columns):
            x = (k + 0.5) / columns * width - width / 2
            if floor == 0 and abs(x - 0.08 * width) < 1.3:
                continue
            low = 0.9 + floor * (height - 0.6) / 2
            for side in (-1, 1):
                things += [
                    again(border, (x, side * depth / 2, low)),
                    again(glass, (x, side * depth / 2, low + 0.13)),
                ]
    return things
