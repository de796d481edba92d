"""Coordinates: affine transforms, rotations of shapes and colours, merged scenes, Morton order."""
