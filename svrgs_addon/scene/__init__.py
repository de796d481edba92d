"""Gaussians and cameras, and their coordinates: affine maps, rotations of Gaussians and of spherical
harmonics, merges, Morton order; Blender's attributes."""
