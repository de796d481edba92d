"""Complete pictures: over meshes, as render passes, live, recoloured; how far two differ (metrics/)."""
