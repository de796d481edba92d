"""Coordinates: affine transforms, rotations of Gaussians and of spherical harmonics, merged scenes, Morton order."""
