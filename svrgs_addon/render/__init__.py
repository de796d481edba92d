"""Complete pictures: compositing with meshes, render passes, live views, quads, colour maps; and how far two
pictures differ (metrics/)."""
