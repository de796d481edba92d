"""Training and pruning as whole jobs: in this process, in a child process of a batch, or in a background process that Blender follows."""
