"""Pruning in a process of its own that Blender starts, watches and survives: folder.py what lies where, child.py, parent.py."""
