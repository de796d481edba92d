"""Jobs outside this process: background jobs that Blender follows, child processes of a batch, and tasks of a
farm (farm/)."""
