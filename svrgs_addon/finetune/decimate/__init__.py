"""Fewer Gaussians in seconds: removals and merges in the order of what they change in pictures of the scene;
no photographs are needed."""
