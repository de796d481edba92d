"""Conventions of Blender, without bpy: attribute layout, activations, cameras, child processes of its Python."""
