"""Posed photographs: COLMAP models, datasets, cameras.json."""
