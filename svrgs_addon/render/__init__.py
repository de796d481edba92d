"""Complete pictures: compositing with meshes, render passes, live views, quads, colour maps."""
