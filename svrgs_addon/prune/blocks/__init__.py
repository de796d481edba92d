"""Scenes larger than memory: divided into blocks on the disk (divided.py), scored view by view (scoring.py),
merged block by block (merging.py)."""
