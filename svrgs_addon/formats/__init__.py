"""Splat files: one module per format, each a reader (path to Scene) and a writer."""

from .finite import clamp_extremes, drop_nonfinite, unusable
from .ply import file_size, read_ply, read_ply_parts, write_ply

__all__ = ["clamp_extremes", "drop_nonfinite", "file_size", "read_ply", "read_ply_parts", "unusable", "write_ply"]
