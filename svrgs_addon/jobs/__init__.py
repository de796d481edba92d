"""Training and pruning as whole jobs, in this process or in one that Blender starts and watches."""
