"""Fuzzing of the readers: what they promise (targets.py), what to start from (seeds.py), how to change it (mutate.py), runs (__main__.py)."""

NAMES = ("ply", "cameras-json", "colmap-binary", "colmap-text", "checkpoint")
