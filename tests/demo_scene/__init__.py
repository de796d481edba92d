"""A small scene modelled and rendered with bpy, written as a COLMAP dataset.

    python -m tests.demo_scene OUT [--views 60] [--width 360] [--samples 8]

OUT/images/*.png         sRGB, 8 bit
OUT/sparse/0/*.bin       one PINHOLE camera, exact poses, surface points with tracks
OUT/demo_scene.json      the stamp: what was asked for, and the marker the tests look for

The world is Blender's (metres, z up); cameras are COLMAP's (x right, y down, z forward).
Importing this package imports neither bpy nor NumPy.
"""
