"""Bytes on disk: splat formats behind one registry, images, atomic writes."""
