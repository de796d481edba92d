"""Files: splat formats and their registry, images, .npz archives, atomic writes."""
