"""Fuzzing of the readers: what they promise (targets.py), what to start from (seeds.py), how to change it
(mutate.py), runs (__main__.py)."""

# Splat formats by their names in the registry, then other files. The registry cannot be asked: --atheris must
# import it itself.
NAMES = (
    "ply", "compressed-ply", "spz", "glb", "glb-spz", "usd", "sog", "streamed-sog", "splat", "ksplat",
    "cameras-json", "transforms-json", "colmap-binary", "colmap-text", "checkpoint",
)  # fmt: skip
