"""Complete pictures: compositing with meshes, passes, live views, quads, colour maps."""
