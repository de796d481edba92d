"""Training and pruning as whole jobs, in memory and by blocks on the disk (blocks/); criteria of a selection
(selection/); the report (report/)."""
