"""Scenes larger than memory: divided into blocks on the disk (blocks.py), scored view by view (scoring.py), pruned by one threshold (pruning.py)."""
