"""Jobs of pruning and training: settings, start, queue, progress, result."""
