"""Recipes of the pipeline (prune/pipeline.py): what each of its steps does in memory, in seconds, in a
training, or by blocks."""
