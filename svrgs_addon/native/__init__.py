"""The native library in Python: the renderer, its structs and checks, pictures, and the order of removals and
merges."""
