"""Views: COLMAP models, transforms.json, cameras.json, photographs, lenses, and cameras that are placed
around a splat (rig/)."""
