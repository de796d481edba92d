"""Conventions of Blender, without bpy: attribute layout, activation, lens, processes of its Python."""
