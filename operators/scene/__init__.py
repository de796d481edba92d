"""The scene: cameras and datasets of splats, selecting and moving Gaussians, what a render needs."""
