"""Posed photographs: COLMAP models, datasets, camera lists."""
