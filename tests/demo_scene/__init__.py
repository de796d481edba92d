"""Scenes modelled and rendered with bpy, written as COLMAP datasets.

    python -m tests.demo_scene OUT [--scene plaza|room|portrait|row] [--views N] [--width PIXELS] [--samples
    N] [--points N]

OUT/images/*.png         sRGB, 8 bit OUT/sparse/0/*.bin       one PINHOLE camera, exact poses, surface points
with tracks OUT/demo_scene.json      the stamp: what was asked for, and what tests look for: plaza's marker,
portrait's gains

scenes.py lists the scenes; each has a module of its name with its model and its cameras.
The world is Blender's (metres, z up); cameras are COLMAP's (x right, y down, z forward).
Importing this package imports neither bpy nor NumPy.
"""
