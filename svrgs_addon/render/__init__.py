"""Complete pictures: compositing with meshes, render passes, live views, other colours; and how far two
pictures differ (metrics/)."""
