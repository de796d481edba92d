"""Fewer Gaussians in seconds, without photographs: removals and merges by what they change in pictures."""
