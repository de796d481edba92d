"""The operating system: the only room with a branch for each one. It imports nothing of the other rooms."""
